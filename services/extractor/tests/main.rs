//! Tests of the extractor's public interface.

mod support {
    pub mod scene;
}

mod extractor;
