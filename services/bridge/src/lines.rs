//! Received frames as lines of JSON. Positions are in metres in the frame of map and detections: the sender's
//! origin is added.

use serde_json::{Value, json};
use wire::{AGENT_TYPES, AgentType, Cause, Quality};

use crate::frame::TickHead;
use crate::frame::forecasts::{Agent, Path};
use crate::receiver::{Body, Received};

/// A frame as a value of JSON, on one line when it is printed.
#[must_use]
pub fn line(received: &Received) -> Value {
    let head = match &received.body {
        Body::Forecasts(forecasts) => &forecasts.head,
        Body::Detections(detections) => &detections.head,
    };
    let mut line = json!({
        "seq": head.seq,
        "stamp_ns": head.stamp_ns,
        "interval_ns": head.interval_ns,
        "age_at_most_ms": received.age_ns / 1_000_000,
        "left_out": head.left_out_len,
    });
    match &received.body {
        Body::Forecasts(forecasts) => {
            line["agents"] = forecasts.agents.iter().map(|of| agent(head, of)).collect();
        }
        Body::Detections(detections) => {
            let own =
                |x_m: f32, y_m: f32| [f64::from(x_m) + head.origin_m[0], f64::from(y_m) + head.origin_m[1]];
            let detection = |of: &wire::Detection| json!({"id": of.id, "type": name(of.agent_type), "position_m": own(of.x_m, of.y_m), "score": of.score});
            line["detections"] = detections.detections.iter().map(detection).collect();
        }
    }
    line
}

fn agent(head: &TickHead, agent: &Agent) -> Value {
    let of = &agent.head;
    let metres = |cm: f64| cm.round() / 100.0;
    let position = |[x_cm, y_cm]: [i32; 2]| {
        [head.origin_m[0] * 100.0 + f64::from(x_cm), head.origin_m[1] * 100.0 + f64::from(y_cm)].map(metres)
    };
    let path = |path: &Path| path.iter().map(|&cm| position(cm)).collect::<Vec<_>>();
    let modes = agent.modes.iter().map(|(probability, steps)| {
        let probability = (f64::from(*probability) / f64::from(u16::MAX) * 1e4).round() / 1e4;
        json!({"probability": probability, "path_m": path(steps)})
    });
    let velocity_mps = [of.vx_cmps, of.vy_cmps].map(|cm| metres(cm.into()));
    let size_m = [of.length_cm, of.width_cm].map(|cm| metres(cm.into()));
    json!({
        "id": of.id,
        "source_id": of.source_id,
        "type": name(of.agent_type.into()),
        "quality": Quality::try_from(u32::from(of.quality)).map_or("unknown", Quality::name),
        "cause": Cause::name_of(of.cause.into()),
        "age_ms": of.age_us / 1_000,
        "position_m": position([of.x_cm, of.y_cm]),
        "velocity_mps": velocity_mps,
        "heading_rad": f64::from(of.heading) / 1e4,
        "size_m": size_m,
        "best_m": path(&agent.best),
        "modes": modes.collect::<Vec<_>>(),
    })
}

fn name(agent_type: u32) -> &'static str {
    AGENT_TYPES.get(agent_type as usize).copied().map_or("unknown", AgentType::name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::forecasts::{AgentHead, Forecasts};

    #[test]
    fn a_line_has_metres_of_the_own_frame_and_names() {
        let head = TickHead { seq: 3, origin_m: [458_000.25, -10.0], ..TickHead::default() };
        let of = AgentHead { id: 7, quality: 1, cause: 1, x_cm: 105, vx_cmps: -250, ..AgentHead::default() };
        let agent = Agent { head: of, best: vec![[110, 0]], modes: vec![(32_768, vec![[111, 1]])] };
        let body = Body::Forecasts(Forecasts { head, agents: vec![agent] });
        let found = line(&Received { body, age_ns: 12_999_999, arrived_ns: 0 });
        assert_eq!((&found["seq"], &found["age_at_most_ms"]), (&json!(3), &json!(12)));
        let agent = &found["agents"][0];
        assert_eq!(
            (&agent["quality"], &agent["cause"], &agent["type"]),
            (&json!("held"), &json!("late"), &json!("vehicle"))
        );
        assert_eq!(
            (&agent["position_m"], &agent["velocity_mps"]),
            (&json!([458_001.3, -10.0]), &json!([-2.5, 0.0]))
        );
        assert_eq!(
            (&agent["best_m"], &agent["modes"]),
            (&json!([[458_001.35, -10.0]]), &json!([{"probability": 0.5, "path_m": [[458_001.36, -9.99]]}]))
        );
    }
}
