//! The retrieval memory: what is retrieved for whom, what it changes, and what its files hold.

mod files;
mod online;
mod passing;
mod selection;
