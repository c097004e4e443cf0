//! The probability of a conflict, against `reference/odds.py`, which computes it in float64.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on should panic")]

use bytemuck::Zeroable as _;
use conflicts::{Moving, Odds, Room, Signs};
use serde::Deserialize;
use wire::{AgentType, Forecast};

#[derive(Deserialize)]
struct Golden {
    dt_s: f32,
    odds: Odds,
    pairs: Vec<Pair>,
}

#[derive(Deserialize)]
struct Pair {
    a: Agent,
    b: Agent,
    signs: Option<Expected>,
}

#[derive(Deserialize)]
struct Agent {
    r#type: String,
    length_m: f32,
    width_m: f32,
    position_m: [f32; 2],
    heading_rad: f32,
    velocity_mps: [f32; 2],
    probability: Vec<f32>,
    best_m: Vec<[f32; 2]>,
    modes_m: Vec<Vec<[f32; 2]>>,
}

#[derive(Deserialize)]
struct Expected {
    conflict: [f32; 3],
    near: f32,
    in_s: f32,
    probability: f32,
}

impl Agent {
    fn moving(&self) -> Moving {
        let agent_type = match self.r#type.as_str() {
            "vehicle" => AgentType::Vehicle,
            "cyclist" => AgentType::Cyclist,
            _ => AgentType::Pedestrian,
        };
        let mut forecast = Forecast {
            agent_type: agent_type as u32,
            length_m: self.length_m,
            width_m: self.width_m,
            x_m: self.position_m[0],
            y_m: self.position_m[1],
            heading_rad: self.heading_rad,
            vx_mps: self.velocity_mps[0],
            vy_mps: self.velocity_mps[1],
            modes_len: self.modes_m.len() as u32,
            ..Forecast::zeroed()
        };
        for (mode, path_m) in self.modes_m.iter().enumerate() {
            forecast.probability[mode] = self.probability[mode];
            forecast.modes[mode][..path_m.len()].copy_from_slice(path_m);
        }
        forecast.best[..self.best_m.len()].copy_from_slice(&self.best_m);
        Moving::of(&forecast, self.modes_m[0].len()).unwrap()
    }
}

#[test]
fn signs_and_probabilities_equal_the_reference() {
    let golden: Golden = serde_json::from_str(include_str!("reference/odds.json")).unwrap();
    let mut room = Room::default();
    let mut judged = 0;
    for (number, Pair { a, b, signs }) in golden.pairs.iter().enumerate() {
        let found = Signs::of(&a.moving(), &b.moving(), golden.dt_s, &mut room);
        assert_eq!(found.is_some(), signs.is_some(), "pair {number}");
        let Some((found, expected)) = found.zip(signs.as_ref()) else { continue };
        judged += 1;
        let probability = golden.odds.probability(&found);
        let pairs =
            [(found.near, expected.near), (found.in_s, expected.in_s), (probability, expected.probability)];
        for (found, expected) in found.conflict.into_iter().zip(expected.conflict).chain(pairs) {
            assert!(
                (found - expected).abs() < 1e-5 * expected.abs().max(1.0),
                "pair {number}: {found}, {expected}"
            );
        }
    }
    assert!(judged >= 25, "{judged} pairs");
}
