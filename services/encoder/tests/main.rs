//! The encoder by its public interface.

mod support {
    pub mod frames;
}

mod encoder;
