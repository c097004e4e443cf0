use std::f32::consts::PI;

use ::scene::{AgentType, MapBuilder};
use metrics::Point;
use resvg::usvg::{Options, Tree};
use wire::tick_view::{AgentView, ForecastView};
use wire::{Cause, Quality};

use super::*;

/// A vehicle that turns left, with a forecast in five directions.
fn turning_vehicle() -> AgentDrawing {
    let step_count = 8;
    let arc = |turn: f32| -> Vec<Point> {
        (1..=step_count).map(|step| [4.0 * step as f32, turn * (step * step) as f32]).collect()
    };
    let modes: Vec<Vec<Point>> = [-0.2, -0.1, 0.0, 0.1, 0.2].map(arc).to_vec();
    let covariance =
        (1..=step_count).map(|step| [0.02, 0.005, 0.03].map(|value| value * (step * step) as f32));
    let forecast = ForecastView {
        quality: Quality::Learned,
        cause: Cause::None as u32,
        age_ns: 0,
        experts: [0.0; wire::EXPERTS_MAX],
        out_of_distribution: 0.0,
        best: arc(0.05),
        covariance: vec![covariance.collect(); modes.len()],
        modes,
        probability: vec![0.1, 0.2, 0.4, 0.2, 0.1],
    };
    AgentDrawing {
        agent: AgentView {
            length_m: Some(4.6),
            width_m: Some(1.9),
            history: vec![Some([-8.0, 0.1]), None, Some([-3.0, 0.0])],
            forecast: Some(forecast),
            ..agent(7, AgentType::Vehicle)
        },
        truth: arc(0.11).into_iter().map(Some).collect(),
    }
}

/// An agent of unknown size at the origin.
fn agent(source_id: u64, agent_type: AgentType) -> AgentView {
    AgentView {
        id: 100,
        source_id,
        agent_type,
        position_m: [0.0; 2],
        velocity_mps: [0.0; 2],
        heading_rad: 0.0,
        length_m: None,
        width_m: None,
        unseen_ns: 0,
        history: Vec::new(),
        forecast: None,
    }
}

fn bystander() -> AgentDrawing {
    let agent = AgentView {
        heading_rad: PI,
        position_m: [5.0, 5.0],
        history: vec![Some([6.0, 5.0])],
        ..agent(8, AgentType::Pedestrian)
    };
    AgentDrawing { agent, truth: Vec::new() }
}

fn drawing(agents: Vec<AgentDrawing>) -> SceneDrawing<'static> {
    SceneDrawing { title: "a <turn> & \"more\"".to_owned(), agents, ..SceneDrawing::default() }
}

fn error_of(change: impl FnOnce(&mut AgentDrawing)) -> String {
    let mut agent = turning_vehicle();
    change(&mut agent);
    scenes("", &[drawing(vec![agent])], &SceneOptions::default()).unwrap_err().to_string()
}

fn forecast(drawing: &mut AgentDrawing) -> &mut ForecastView {
    drawing.agent.forecast.as_mut().unwrap()
}

/// Width and height of a well-formed picture, pt.
fn size_pt(svg: &str) -> [f32; 2] {
    let size = Tree::from_str(svg, &Options::default()).unwrap().size();
    // CSS has 96 pixels to the inch.
    [size.width(), size.height()].map(|pixels| pixels * 72.0 / 96.0)
}

#[test]
fn a_scene_is_well_formed_and_the_same_every_time() {
    let mut builder = MapBuilder::new([-10.0, -10.0], 30, 60).unwrap();
    for step in 0..200 {
        builder.visit([-9.0 + 0.25 * step as f32, 0.3], [5.0, 0.0]);
    }
    let map = builder.build();
    for mask in [Mask::EveryMoment, Mask::Pooled, Mask::End, Mask::Hidden] {
        let options = SceneOptions { mask, velocity: true, identities: true, ..SceneOptions::default() };
        let panel = SceneDrawing { map: Some(&map), ..drawing(vec![turning_vehicle(), bystander()]) };
        let panels = [panel.clone(), panel.clone(), panel];
        let svg = scenes("three & a heading", &panels, &options).unwrap();
        assert_eq!(svg, scenes("three & a heading", &panels, &options).unwrap(), "{mask:?}");
        let [width, height] = size_pt(&svg);
        assert!((width - 516.0).abs() < 0.1, "{width} pt");
        assert!(height > width / 2.0, "two rows of panels, {height} pt high");
        assert_eq!(svg.contains("90 % region"), mask != Mask::Hidden);
    }
}

#[test]
fn what_is_drawn_is_what_is_seen() {
    let ink = |agents: Vec<AgentDrawing>| {
        let svg = scenes("", &[drawing(agents)], &SceneOptions::default()).unwrap();
        ["#e69f00", "#0072b2", "#d55e00", "#009e73"].map(|colour| svg.matches(colour).count())
    };
    let [history, truth, best, mask] = ink(vec![turning_vehicle()]);
    assert!(history > 1 && truth > 1 && best > 1 && mask > 1, "each in the panel and in the legend");
    assert_eq!(ink(vec![bystander()])[1..], [0; 3]);
    let svg = |drawing| scenes("", &[drawing], &SceneOptions::default()).unwrap();
    let words = ["best forecast", "best of 5 in hindsight", "too young", "lanes"];
    let said = |svg: &str| words.map(|words| svg.contains(&format!("aria-label=\"{words}\"")));
    assert_eq!(said(&svg(drawing(vec![turning_vehicle()]))), [true, true, false, false]);
    let mut young = turning_vehicle();
    young.truth.clear();
    forecast(&mut young).quality = Quality::Kinematic;
    forecast(&mut young).cause = Cause::Young as u32;
    let lanes = vec![vec![[0.0, -2.0], [20.0, -2.0]]];
    assert_eq!(said(&svg(SceneDrawing { lanes, ..drawing(vec![young]) })), [true, false, true, true]);
}

#[test]
fn numbers_that_are_none_are_refused() {
    for (expected, error) in [
        ("agent 7: its heading is not finite", error_of(|drawing| drawing.agent.heading_rad = f32::NAN)),
        ("its truth is not finite", error_of(|agent| agent.truth[1] = Some([f32::INFINITY, 0.0]))),
        ("its forecast is not finite", error_of(|agent| forecast(agent).modes[2][1][0] = f32::NAN)),
        (
            "mode 1, step 3: covariance [1.0, 2.0, 1.0] is not positive",
            error_of(|agent| forecast(agent).covariance[1][3] = [1.0, 2.0, 1.0]),
        ),
        ("the best forecast has length 7, expected 8", error_of(|agent| forecast(agent).best.truncate(7))),
        ("a mode has length 7, expected 8", error_of(|agent| forecast(agent).modes[4].truncate(7))),
        (
            "the modes' probabilities has length 4, expected 5",
            error_of(|agent| forecast(agent).probability.truncate(4)),
        ),
        ("the sum of an agent's probabilities is", error_of(|agent| forecast(agent).probability[2] = 0.9)),
        ("the number of modes is 0", error_of(|agent| forecast(agent).modes.clear())),
    ] {
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn pictures_that_can_not_be_are_refused() {
    let draw = |panels: &[SceneDrawing<'_>], options| scenes("", panels, &options).unwrap_err().to_string();
    let usual = SceneOptions::default();
    assert_eq!(draw(&[], usual), "a picture without panels");
    assert_eq!(draw(&[drawing(Vec::new())], usual), "a picture without panels");
    let panel = || [drawing(vec![turning_vehicle()])];
    let error = draw(&panel(), SceneOptions { columns: 0, ..usual });
    assert_eq!(error, "the number of columns is 0, which is not within 1 and 16");
    assert!(draw(&panel(), SceneOptions { width: f64::NAN, ..usual }).contains("the width in pt is NaN"));
}

#[test]
fn learning_curves_show_each_set_and_the_best_checkpoint() {
    let progress = (1..=50).map(|step| Progress {
        step: 20 * step,
        seconds: 3.0 * step as f64,
        rate: 1e-3,
        loss: 1.0 / step as f64,
        ..Progress::default()
    });
    let validation = |(number, figure): (usize, f64)| Validation {
        step: 250 * (number as u64 + 1),
        validation: figure,
        sets: vec![SetErrors { set: "sdd".to_owned(), ..SetErrors::default() }],
    };
    let validations = [0.9, 0.7, 0.75, 0.8].into_iter().enumerate().map(validation);
    let log = TrainingLog { progress: progress.collect(), validations: validations.collect() };
    let svg = learning_curves(&log, "plus").unwrap();
    assert_eq!(svg, learning_curves(&log, "plus").unwrap());
    for words in
        ["aria-label=\"sdd\"", "best: 0.7000", "best checkpoint at step 500", "1000 steps in 0 h 03 min"]
    {
        assert!(svg.contains(words), "{words} is missing");
    }
    assert!((size_pt(&svg)[0] - 516.0).abs() < 0.1);
    assert!(learning_curves(&TrainingLog::default(), "nothing").is_err());
}
