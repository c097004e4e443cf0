//! The decoder by its public interface: controls of every tick, and refusals.

mod support {
    pub mod frames;
}

mod decoder;
