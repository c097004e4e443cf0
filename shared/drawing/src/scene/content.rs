use metrics::Point;
use scene::ContextMap;
use wire::tick_view::AgentView;

use crate::mask::Mask;

/// A moment of a recording, with the forecasts made at that moment.
#[derive(Clone, Debug, Default)]
pub struct SceneDrawing<'a> {
    /// The title of the panel.
    pub title: String,
    /// Further text, in smaller type.
    pub note: String,
    /// The context map to draw beneath.
    pub map: Option<&'a ContextMap>,
    /// The bounds of lanes.
    pub lanes: Vec<Vec<Point>>,
    /// The agents. The panel is about the agents with a forecast.
    pub agents: Vec<AgentDrawing>,
}

/// An agent of a scene.
#[derive(Clone, Debug)]
pub struct AgentDrawing {
    /// The agent with its published forecast. Vehicles are drawn as boxes, all others as discs.
    pub agent: AgentView,
    /// Observed future positions, one per step.
    pub truth: Vec<Option<Point>>,
}

/// How scenes are drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SceneOptions {
    /// Width of the picture, pt. A column of a two-column paper has about 252 pt, a page 516 pt.
    pub width: f64,
    /// Number of panels side by side.
    pub columns: usize,
    /// Height of a panel relative to its width.
    pub height_per_width: f64,
    /// Smallest extent of the world in a panel, m. The default is 30 m around vehicles and 12 m around
    /// others.
    pub extent_min_m: Option<f64>,
    /// The times that the mask covers.
    pub mask: Mask,
    /// Whether the map's mean velocities are drawn as arrows.
    pub velocity: bool,
    /// Whether agents are labelled with their identities.
    pub identities: bool,
}

impl Default for SceneOptions {
    fn default() -> Self {
        Self {
            width: 516.0,
            columns: 2,
            height_per_width: 0.8,
            extent_min_m: None,
            mask: Mask::default(),
            velocity: false,
            identities: false,
        }
    }
}

pub(in super::super) const LABEL_SIZE: f64 = 7.0;
