//! Pictures as SVG: recordings, forecasts of scenes, learning curves.
//!
//! [`overview`] draws a whole recording. [`scenes`] draws forecasts of scenes. [`noisy_track`] draws one
//! agent under noise. [`learning_curves`] draws a [`TrainingLog`]. A picture consists of *panels*. The panel of a scene shows these layers, from bottom to
//! top:
//!
//! 1. how often the ground was visited (the context map);
//! 2. the *mask* of the forecast distribution;
//! 3. every mode, fainter if less probable;
//! 4. the recorded future;
//! 5. the best and the most probable mode;
//! 6. the agents at their true sizes.
//!
//! The mask is drawn as *highest-density regions*: the smallest areas that contain 50 % and 90 % of the
//! mixture of all modes.
//!
//! A picture is one string. The same input gives the same string. Text is drawn as outlines of an embedded
//! font, so a picture looks the same in every viewer. Lengths on paper are in points (pt, 1/72 inch).

mod axes;
mod canvas;
mod colour;
mod contour;
mod curves;
mod error;
mod ground;
mod mask;
mod mixture;
mod noisy_track;
mod overview;
mod path;
mod scene;
#[cfg(test)]
mod tests;
mod text;
mod training_log;
mod view;

pub use curves::learning_curves;
pub use error::PictureError;
pub use mask::Mask;
pub use noisy_track::{NoisyTrack, noisy_track};
pub use overview::{Overview, overview};
pub use scene::{AgentDrawing, SceneDrawing, SceneOptions, scenes};
pub use training_log::{LogError, Progress, SetErrors, TrainingLog, Validation};
