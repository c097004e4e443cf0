use kinematics::{Displacement, DisplacementKind, DisplacementState, Motion};
use nalgebra::Vector2;
use nn::Integrator;

use super::*;
use crate::tests::check::{check, values, weighted};
use crate::tests::golden::Golden;

const STEPS: usize = 12;
const DRAWS: usize = 3;
/// Not a whole number of vectors.
const AGENTS: usize = 7;
const ROWS: usize = AGENTS * DRAWS;

fn starts() -> Vec<Start> {
    let random = values(AGENTS * 6, 1.0, 1);
    let start = |at: &[f32]| Start {
        velocity_mps: [4.0 * at[0], at[1]],
        heading_rad: 3.0 * at[2],
        speed_mps: 4.0 + 6.0 * at[3],
        slip_rad: 0.3 * at[4],
        rear_axle_m: 1.2 + 0.5 * at[5],
    };
    random.chunks_exact(6).map(start).collect()
}

/// Controls that reach the limits of acceleration, slip rate and slip angle.
fn controls() -> Matrix {
    let values = values(ROWS * STEPS * 2, 1.0, 2);
    let values = values.iter().enumerate().map(|(i, value)| value * if i % 2 == 0 { 9.0 } else { 1.0 });
    Matrix::new(ROWS, STEPS * 2, values.collect())
}

/// Vehicles with either integrator, with and without a limit of the slip.
fn vehicle_configs() -> [ModelConfig; 4] {
    let choices = [
        (Integrator::Euler, Some(0.3)),
        (Integrator::Euler, None),
        (Integrator::Midpoint, Some(0.3)),
        (Integrator::Midpoint, None),
    ];
    choices.map(|(integrator, slip_limit_rad)| ModelConfig {
        integrator,
        slip_limit_rad,
        ..crate::options::onboard_config()
    })
}

#[test]
fn vehicles_agree_with_the_kinematics() {
    let (starts, controls) = (starts(), controls());
    let mut cut = 0;
    for config in vehicle_configs() {
        let positions = positions(&config, AgentType::Vehicle, &starts, DRAWS, &controls);
        for row in 0..ROWS {
            let start = starts[row / DRAWS];
            let (vehicle, mut state) = start.bicycle(&config);
            for step in 0..STEPS {
                let at = 2 * step;
                let control = Vector2::from_row_slice(&controls.row(row)[at..at + 2]);
                state = vehicle.step(&state, &vehicle.saturate(&control).0);
                cut += usize::from(config.slip_limit_rad == Some(state[4].abs()));
                for axis in 0..2 {
                    let (ours, theirs) = (positions.row(row)[at + axis], state[axis]);
                    assert!((ours - theirs).abs() < 2e-4, "row {row} step {step}: {ours}, not {theirs}");
                }
            }
        }
    }
    assert!(cut > 20, "the slip reached its limit {cut} times");
}

#[test]
fn vehicles_agree_with_the_golden_vectors() {
    for golden in Golden::all() {
        let vehicles: Vec<usize> =
            (0..golden.types.len()).filter(|&agent| golden.types[agent] == 0).collect();
        let draw_count = golden.tensor("bicycle.mean").0[0];
        // Our rows are sorted by agent and then draw, the vectors by draw and then agent.
        let rows = |name: &str, agents: &[usize]| {
            golden.rows(
                name,
                agents.iter().flat_map(|&agent| (0..draw_count).map(move |draw| vec![draw, agent])),
            )
        };
        let initial = golden.tensor("bicycle.initial").1;
        let starts: Vec<Start> = initial
            .as_chunks::<5>()
            .0
            .iter()
            .map(|&[_, _, heading_rad, speed_mps, slip_rad]| Start {
                heading_rad,
                speed_mps,
                slip_rad,
                rear_axle_m: golden.scene["rear_axle_m"].as_f64().unwrap() as f32,
                ..Start::default()
            })
            .collect();
        let width = golden.config.horizon_len * 2;
        let controls = Matrix::new(starts.len() * draw_count, width, rows("control.mean", &vehicles));
        for (integrator, name) in
            [(Integrator::Euler, "bicycle.mean"), (Integrator::Midpoint, "bicycle.midpoint_mean")]
        {
            let config = ModelConfig {
                integrator,
                accel_limit_mps2: 5.0,
                slip_rate_limit_radps: 0.5,
                slip_limit_rad: None,
                ..golden.config.clone()
            };
            let found = positions(&config, AgentType::Vehicle, &starts, draw_count, &controls);
            // Our trajectories begin at the origin.
            let states = rows(name, &(0..vehicles.len()).collect::<Vec<usize>>());
            let expected = states.as_chunks::<5>().0.iter().enumerate().flat_map(|(number, state)| {
                let vehicle = number / golden.config.horizon_len / draw_count;
                [state[0] - initial[5 * vehicle], state[1] - initial[5 * vehicle + 1]]
            });
            golden.check(name, &found.values, &expected.collect::<Vec<f32>>());
        }
    }
}

#[test]
fn displacements_agree_with_the_kinematics() {
    let (starts, controls) = (starts(), controls());
    for (displacement, kind) in [
        (nn::Displacement::Residual, DisplacementKind::Residual),
        (nn::Displacement::Absolute, DisplacementKind::Absolute),
    ] {
        let config = ModelConfig { displacement, ..crate::options::onboard_config() };
        let motion = Displacement::new(kind, 0.0, config.dt_s as f32);
        let positions = positions(&config, AgentType::Pedestrian, &starts, DRAWS, &controls);
        for row in 0..ROWS {
            let [vx, vy] = starts[row / DRAWS].velocity_mps;
            let mut state = DisplacementState::new(0.0, 0.0, vx, vy);
            for step in 0..STEPS {
                let at = 2 * step;
                state = motion.step(&state, &Vector2::from_row_slice(&controls.row(row)[at..at + 2]));
                for axis in 0..2 {
                    let (ours, theirs) = (positions.row(row)[at + axis], state[axis]);
                    assert!((ours - theirs).abs() < 1e-4, "row {row} step {step}: {ours}, not {theirs}");
                }
            }
        }
    }
}

#[test]
fn gradients_by_the_controls_agree_with_differences() {
    let (starts, controls) = (starts(), controls());
    let weights = Matrix::new(ROWS, STEPS * 2, values(ROWS * STEPS * 2, 1.0, 3));
    let mut cases: Vec<(AgentType, ModelConfig)> =
        vehicle_configs().map(|config| (AgentType::Vehicle, config)).into();
    let vehicle_motion = nn::VehicleMotion::Displacement;
    cases.push((AgentType::Vehicle, ModelConfig { vehicle_motion, ..crate::options::onboard_config() }));
    cases.push((AgentType::Cyclist, crate::options::onboard_config()));
    for (agent_type, config) in cases {
        let gradient = positions_backward(&config, agent_type, &starts, DRAWS, &controls, &weights);
        let name = format!("{agent_type:?}, {:?}, slip {:?}", config.integrator, config.slip_limit_rad);
        check(&name, &controls.values, &gradient.values, (1e-2, 60), |moved| {
            let moved = Matrix::new(ROWS, STEPS * 2, moved.to_vec());
            weighted(&positions(&config, agent_type, &starts, DRAWS, &moved).values, &weights.values)
        });
    }
}

#[test]
fn no_rows_give_no_positions() {
    let none = Matrix::zeros(0, STEPS * 2);
    for agent_type in wire::AGENT_TYPES {
        let config = crate::options::onboard_config();
        assert_eq!(positions(&config, agent_type, &[], DRAWS, &none), none);
        assert_eq!(positions_backward(&config, agent_type, &[], DRAWS, &none, &none), none);
    }
}

/// Outputs of the decoder's head, with some ln l beyond the limits.
fn raw() -> Matrix {
    Matrix::new(ROWS, STEPS * 5, values(ROWS * STEPS * 5, 3.0, 4))
}

#[test]
fn noise_is_scaled_by_the_cholesky_factor() {
    let (raw, mean) = (raw(), controls());
    let noise = Matrix::new(ROWS, STEPS * 2, values(ROWS * STEPS * 2, 1.0, 5));
    let drawn = noisy_controls(&raw, &mean, &noise);
    for row in 0..ROWS {
        for step in 0..STEPS {
            let raw = &raw.row(row)[5 * step..][..5];
            let pair = |matrix: &Matrix| Vector2::from_row_slice(&matrix.row(row)[2 * step..][..2]);
            let [l11, l22] = [raw[2], raw[3]].map(|ln| ln.clamp(-5.0, 2.0).exp());
            let gaussian = kinematics::ControlGaussian::new(pair(&mean).into(), [l11, raw[4], l22]);
            let expected = gaussian.mean + gaussian.cholesky * pair(&noise);
            assert!((pair(&drawn) - expected).norm() < 1e-5 * expected.norm().max(1.0));
        }
    }
}

#[test]
fn gradients_by_the_cholesky_factor_agree_with_differences() {
    let (raw, mean) = (raw(), Matrix::zeros(ROWS, STEPS * 2));
    let noise = Matrix::new(ROWS, STEPS * 2, values(ROWS * STEPS * 2, 1.0, 5));
    let weights = Matrix::new(ROWS, STEPS * 2, values(ROWS * STEPS * 2, 1.0, 6));
    // Gradients of other terms stay unchanged.
    let mut gradient = Matrix::new(ROWS, STEPS * 5, vec![1.0; ROWS * STEPS * 5]);
    noisy_controls_backward(&raw, &noise, &weights, &mut gradient);
    gradient.values.iter_mut().for_each(|value| *value -= 1.0);
    assert!(gradient.values.chunks_exact(5).all(|step| step[..2] == [0.0; 2]), "the mean has no gradient");
    check("noisy controls", &raw.values, &gradient.values, (1e-2, 100), |moved| {
        let moved = Matrix::new(ROWS, STEPS * 5, moved.to_vec());
        weighted(&noisy_controls(&moved, &mean, &noise).values, &weights.values)
    });
}
