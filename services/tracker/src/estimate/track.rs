use filters::{Filter, Gaussian};
use wire::{AgentType, Detection, Track};

use super::chord::Chord;
use super::gate::Gate;
use super::held::Held;
use super::published::Published;
use super::reports::Reports;
use super::size::Size;
use super::whole::Whole;
use super::{Birth, Estimate};
use crate::belief::Belief;
use crate::class::Class;
use crate::front::Front;
use crate::noise::Measurements;
use crate::observation::Found;
use crate::options::InputModel;
use crate::steady::Steady;
use crate::track_management::TrackManagement;
use crate::trials::Trials;

impl Estimate {
    /// The estimate of a track of known type that another tracker has published at `stamp_ns`.
    #[must_use]
    pub fn of_track(
        (birth, seed): (Birth, u64),
        stamp_ns: i64,
        (track, agent_type): (&Track, AgentType),
        input: &InputModel,
        trusted: bool,
    ) -> Self {
        let belief = Belief::new(filter(track));
        let heading_rad = f64::from(track.heading_rad);
        let unseen_ns = track.unseen_ns;
        let age_ns = stamp_ns.saturating_sub(birth.stamp_ns).max(0).unsigned_abs();
        let existence = f64::from(track.existence);
        let seen_ns = stamp_ns.saturating_sub_unsigned(unseen_ns);
        let last = Detection { x_m: track.x_m, y_m: track.y_m, ..Detection::default() };
        let last = Found { detection: &last, agent_type, own_ns: seen_ns };
        Self {
            class: Class::of(agent_type, track.type_probability.map(f64::from)),
            birth,
            source_id: track.source_id,
            seed,
            stamp_ns,
            frame_ns: stamp_ns,
            seen_ns,
            controls_ns: None,
            front_ns: birth.stamp_ns,
            management: TrackManagement::of_confirmed(existence, (age_ns, unseen_ns), trusted, input),
            front: Front::new(),
            has_velocity: true,
            was_ready: true,
            dt_ns: 0,
            visibility: 1.0,
            published: Published::new(belief.filter(), heading_rad, heading_rad),
            held: Held::new(belief.motion(), stamp_ns),
            size: Size::of_track(track),
            whole: Whole::new(0.0),
            trials: Trials::default(),
            reports: Reports::new(&last),
            chord: Chord::default(),
            gate: Gate::new(seen_ns),
            is_replaced: false,
            steady: Steady::new(belief.filter()),
            measurements: Measurements::default(),
            nominal_m: 0.0,
            belief,
        }
    }
}

/// The state of a published track.
fn filter(track: &Track) -> Filter {
    let [x, y] = [track.x_m, track.y_m].map(f64::from);
    if track.state_len == 5 {
        let [heading, speed, slip] = [track.heading_rad, track.speed_mps, track.slip_rad].map(f64::from);
        return Filter::Bicycle(gaussian([x, y, heading, speed, slip], &track.covariance));
    }
    let [vx, vy] = [track.vx_mps, track.vy_mps].map(f64::from);
    Filter::ConstantVelocity(gaussian([x, y, vx, vy], &track.covariance))
}

fn gaussian<const N: usize>(mean: [f64; N], covariance: &[f32; 25]) -> Gaussian<N> {
    let mut state = Gaussian::new(mean, [0.0; N]);
    for (value, number) in state.covariance.as_mut_slice().iter_mut().zip(covariance) {
        *value = f64::from(*number);
    }
    state
}
