//! The view of a tick: everything that a picture shows of it, from the published `tracks` and `forecasts`.
//!
//! Every picture of forecasts is drawn from a [`TickView`], so all pictures show the forecasts that the run
//! published.

use crate::{
    AgentType, EXPERTS_MAX, Forecast, HISTORY_MAX, HORIZON_MAX, Header, HistoryState, MODES_MAX, Quality,
    StageId, Track, flags,
};

/// A position in the world frame, m.
pub type Point = [f32; 2];

/// The agents and forecasts of a tick.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TickView {
    /// Number of the tick.
    pub seq: u64,
    /// Time of validity on the recording's clock.
    pub stamp_ns: i64,
    /// Δt: step k of a forecast is at the stamp + (k + 1) Δt.
    pub step_ns: u64,
    /// Position and heading of the ego vehicle, if the detections were made from it.
    pub ego: Option<(Point, f32)>,
    /// Doubts about the input so far: bits of [`doubts`](crate::doubts).
    pub doubts: u32,
    /// Time from the tick's release to the sending of its forecasts; `None` if it did not pass the sampler.
    pub end_to_end_ns: Option<u64>,
    /// The stages that the tick passed, each with the number of its earlier starts.
    pub starts: Vec<(StageId, u32)>,
    /// Whether no detections arrived for the tick, so that its tracks are predicted.
    pub is_predicted: bool,
    /// The tracks, in the order of the frame.
    pub agents: Vec<AgentView>,
}

/// A track.
#[derive(Clone, Debug, PartialEq)]
pub struct AgentView {
    /// The track's number.
    pub id: u64,
    /// The agent's identity in the recording; 0 if it has none.
    pub source_id: u64,
    /// The type.
    pub agent_type: AgentType,
    /// Position at the stamp.
    pub position_m: Point,
    /// Velocity at the stamp.
    pub velocity_mps: Point,
    /// Heading at the stamp, counter-clockwise from +x.
    pub heading_rad: f32,
    /// Extent along the heading; `None` if it is unknown.
    pub length_m: Option<f32>,
    /// Extent across the heading; `None` if it is unknown.
    pub width_m: Option<f32>,
    /// Time since the last detection.
    pub unseen_ns: u64,
    /// Positions before the stamp, oldest first and Δt apart; `None` if the track did not exist.
    pub history: Vec<Option<Point>>,
    /// The published forecast; `None` if there is none.
    pub forecast: Option<ForecastView>,
}

/// A published forecast: the single best one and, at each step, a mixture with one Gaussian per mode.
#[derive(Clone, Debug, PartialEq)]
pub struct ForecastView {
    /// How the forecast was made.
    pub quality: Quality,
    /// [`Cause`](crate::Cause) as a number: why the quality is not `learned`. It may be a newer version's.
    pub cause: u32,
    /// Age of the controls.
    pub age_ns: u64,
    /// Weight of each expert by its number; zeros if they are not reported.
    pub experts: [f32; EXPERTS_MAX],
    /// Distance of the agent's history from the training data; 0 inside.
    pub out_of_distribution: f32,
    /// The single best forecast (K = 1), by step.
    pub best: Vec<Point>,
    /// Mean positions, \[mode, step\].
    pub modes: Vec<Vec<Point>>,
    /// Probability of each mode.
    pub probability: Vec<f32>,
    /// Covariances (xx, xy, yy), \[mode, step\], m².
    pub covariance: Vec<Vec<[f32; 3]>>,
}

impl TickView {
    /// The view of a tick. Tracks and forecasts are frames of the same tick. Forecasts are matched to tracks
    /// by id. Tracks of an unknown type are left out.
    #[must_use]
    pub fn new((header, tracks): (&Header, &[Track]), (of, forecasts): (&Header, &[Forecast])) -> Self {
        let history_len = (header.counts.history_len as usize).min(HISTORY_MAX);
        let horizon_len = (of.counts.horizon_len as usize).min(HORIZON_MAX);
        let agents = tracks.iter().filter_map(|track| {
            let forecast = forecasts.iter().find(|forecast| forecast.id == track.id);
            let forecast = forecast.and_then(|forecast| ForecastView::new(forecast, horizon_len));
            AgentView::new(track, history_len, forecast)
        });
        let sent_ns = of.hop(StageId::Sampler).map(|hop| hop.sent_ns);
        let starts =
            of.hops().iter().filter_map(|hop| Some((StageId::from_number(hop.stage)?, hop.incarnation)));
        Self {
            seq: header.seq,
            stamp_ns: header.stamp_ns,
            step_ns: header.step_ns,
            end_to_end_ns: sent_ns.map(|sent_ns| sent_ns.saturating_sub(of.released_ns)),
            starts: starts.collect(),
            ego: header.has(flags::SEEN_FROM_EGO).then_some((header.ego_m, header.ego_heading_rad)),
            doubts: header.input.doubts,
            is_predicted: header.has(flags::PREDICTED),
            agents: agents.collect(),
        }
    }
}

impl AgentView {
    fn new(track: &Track, history_len: usize, forecast: Option<ForecastView>) -> Option<Self> {
        let known = |size_m: f32| Some(size_m).filter(|size_m| *size_m > 0.0);
        let position = |state: &HistoryState| (state.present != 0).then_some([state.x_m, state.y_m]);
        // The newest state is the present.
        let (_, past) = track.history[..history_len].split_last()?;
        Some(Self {
            id: track.id,
            source_id: track.source_id,
            agent_type: track.agent_type().ok()?,
            position_m: [track.x_m, track.y_m],
            velocity_mps: [track.vx_mps, track.vy_mps],
            heading_rad: track.heading_rad,
            length_m: known(track.length_m),
            width_m: known(track.width_m),
            unseen_ns: track.unseen_ns,
            history: past.iter().map(position).collect(),
            forecast,
        })
    }

    /// The identity that users see: the agent's identity in the recording, or the track's number if it has
    /// none.
    pub const fn known_as(&self) -> u64 {
        if self.source_id == 0 { self.id } else { self.source_id }
    }
}

impl ForecastView {
    fn new(forecast: &Forecast, horizon_len: usize) -> Option<Self> {
        let modes_len = (forecast.modes_len as usize).min(MODES_MAX);
        let modes = forecast.modes[..modes_len].iter().map(|mode| mode[..horizon_len].to_vec());
        let covariance =
            forecast.mode_covariance[..modes_len].iter().map(|mode| mode[..horizon_len].to_vec());
        Some(Self {
            quality: *Quality::ALL.get(forecast.quality as usize)?,
            cause: forecast.cause,
            age_ns: forecast.age_ns,
            experts: forecast.expert_weights,
            out_of_distribution: forecast.out_of_distribution,
            best: forecast.best[..horizon_len].to_vec(),
            modes: modes.collect(),
            probability: forecast.probability[..modes_len].to_vec(),
            covariance: covariance.collect(),
        })
    }
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable;

    use super::*;

    #[test]
    fn a_view_has_the_published_numbers_and_matches_forecasts_by_track() {
        let mut header = Header {
            step_ns: 400_000_000,
            flags: flags::SEEN_FROM_EGO,
            ego_m: [1.0, 2.0],
            ..Header::new(1, 7, 80)
        };
        (header.counts.history_len, header.counts.horizon_len) = (3, 2);
        let mut track = Track { id: 5, source_id: 41, x_m: 3.0, length_m: 4.5, ..Track::zeroed() };
        track.history[1] = HistoryState { x_m: 2.0, present: 1, ..HistoryState::default() };
        track.history[2] = HistoryState { x_m: 3.0, present: 1, ..HistoryState::default() };
        let mut forecast =
            Forecast { id: 5, modes_len: 2, quality: Quality::Held as u32, cause: 17, ..Forecast::zeroed() };
        forecast.best[1] = [9.0, 0.0];
        forecast.modes[1][0] = [4.0, 1.0];
        forecast.probability[..2].copy_from_slice(&[0.25, 0.75]);
        let other = Forecast { id: 6, ..forecast };
        let tracks = [track, Track { id: 8, ..Track::zeroed() }];
        let view = TickView::new((&header, &tracks), (&header, &[other, forecast]));
        assert_eq!((view.seq, view.ego, view.agents.len()), (7, Some(([1.0, 2.0], 0.0)), 2));
        let agent = &view.agents[0];
        assert_eq!((agent.known_as(), agent.length_m, agent.width_m), (41, Some(4.5), None));
        assert_eq!(agent.history, [None, Some([2.0, 0.0])]);
        let forecast = agent.forecast.as_ref().unwrap();
        assert_eq!(
            (forecast.quality, forecast.best.as_slice()),
            (Quality::Held, &[[0.0; 2], [9.0, 0.0]][..])
        );
        assert_eq!(forecast.cause, 17, "the cause of a newer version");
        assert_eq!((forecast.modes[1][0], forecast.probability[1]), ([4.0, 1.0], 0.75));
        assert_eq!((view.agents[1].known_as(), &view.agents[1].forecast), (8, &None));
    }
}
