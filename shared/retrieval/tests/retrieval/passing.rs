//! Memories that passing agents have filled.

use retrieval::{BicycleKey, Key, Query, RetrievalMemory, Retrieved};

pub const STEP_NS: u64 = 500_000_000;
pub const STEP_S: f32 = 0.5;
pub const HORIZON_LEN: usize = 4;

/// At the origin, at 8 m/s along x.
pub const AT_ZERO: BicycleKey = BicycleKey {
    position_m: [0.0; 2],
    heading_rad: 0.0,
    speed_mps: 8.0,
    acceleration_mps2: 0.0,
    turn_rate_radps: 0.0,
};

/// The same at another x.
pub fn at_x(x_m: f32) -> Key {
    Key::Bicycle(BicycleKey { position_m: [x_m, 0.0], ..AT_ZERO })
}

pub fn retrieve(memory: &RetrievalMemory, agent: u64, key: &Key) -> Retrieved {
    let mut retrieved = Retrieved::default();
    memory.retrieve(agent, key, &mut retrieved);
    retrieved
}

/// Lets an agent pass along `path`. At `start_ns` it is at `path(0)` and is stored with a forecast. It is
/// then observed every `tick_s` up to `until_s` later. Returns the final time.
pub fn pass(
    memory: &mut RetrievalMemory,
    (agent, key): (u64, Key),
    forecast_m: &[[f32; 2]],
    (start_ns, tick_s, until_s): (i64, f32, f32),
    path: impl Fn(f32) -> [f32; 2],
) -> i64 {
    let mut stamp_ns = start_ns;
    for tick in 0..=(until_s / tick_s).round() as usize {
        stamp_ns += (f64::from(tick_s) * 1e9) as i64;
        assert!(memory.observe(stamp_ns, [(agent, path(tick_s * tick as f32))]));
        if tick == 0 {
            let query = Query { stamp_ns, agent, key };
            memory.retrieve_and_store(&query, forecast_m, &mut Retrieved::default());
        }
    }
    stamp_ns
}

/// Straight ahead from the origin at 8 m/s.
pub fn straight() -> Vec<[f32; 2]> {
    (1..=HORIZON_LEN).map(|step| [4.0 * step as f32, 0.0]).collect()
}

/// A memory of agents that pass in turn, observed every `tick_s`. All are forecast straight ahead from the
/// origin at 8 m/s, and accelerate by `acceleration_mps2` from there.
pub fn after(agents: u64, acceleration_mps2: f32, tick_s: f32, until_s: f32) -> RetrievalMemory {
    let mut memory = RetrievalMemory::new(HORIZON_LEN, STEP_NS);
    let mut now_ns = 0;
    for agent in 1..=agents {
        let path = |t_s: f32| [8.0 * t_s + 0.5 * acceleration_mps2 * t_s * t_s, 0.0];
        let when = (now_ns, tick_s, until_s);
        now_ns = pass(&mut memory, (agent, at_x(0.0)), &straight(), when, path) + 10_000_000_000;
    }
    memory
}
