//! Tests of the decoder's public interface: the controls of each tick and rejected frames.

mod support {
    pub mod frames;
}

mod decoder;
