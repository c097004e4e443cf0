//! The extractor by its public interface.

mod support {
    pub mod scene;
}

mod extractor;
