//! Tests of the encoder's public interface.

mod support {
    pub mod frames;
}

mod encoder;
