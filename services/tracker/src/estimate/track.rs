use filters::{Filter, Gaussian};
use wire::Track;

/// The state of a published track.
pub(super) fn filter(track: &Track) -> Filter {
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
