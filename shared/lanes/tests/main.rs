//! Lane maps: reading, sites, and forecasts along lanes.

mod guide;
mod reader;
mod sites;
