//! Pictures of published forecasts: their coordinates are the published numbers.
#![expect(clippy::unwrap_used, reason = "a test ends at what it can't do")]

use std::path::Path;
use std::process::Command;

use nn::Weights;
use onboard::Chain;
use recorder::ForecastWriter;
use recording::{About, Frame, Writer};
use run::Run;
use source::{Playback, PlaybackOptions};
use testing::Scratch;
use wire::{ForecastsTopic, TracksTopic, WorldOrigin};

type Point = [f64; 2];

/// The lines of a picture: the spots of each path that consists of straight parts and is not closed.
fn lines_of(svg: &str) -> Vec<Vec<Point>> {
    let paths = svg.split(" d=\"").skip(1).filter_map(|rest| rest.split('"').next());
    let straight = paths.filter(|path| !path.contains(['Q', 'C', 'Z', 'H', 'V']));
    let spots = |path: &str| -> Option<Vec<Point>> {
        let parts = path.trim_start_matches('M').split(['L', 'M']);
        parts
            .map(|part| {
                let mut numbers = part.split_whitespace().map(|number| number.parse().ok());
                Some([numbers.next()??, numbers.next()??])
            })
            .collect()
    };
    straight.filter_map(spots).collect()
}

/// The largest distance between the spots of a line and the points of a path under a map from metres to spots,
/// (scale, x, y). The y axis of a picture points down.
fn apart(line: &[Point], path: &[Point], (scale, x, y): (f64, f64, f64)) -> f64 {
    let spot = |[px, py]: &Point| [scale * px + x, y - scale * py];
    let each = line.iter().zip(path).map(|(of_line, point)| {
        let spot = spot(point);
        (of_line[0] - spot[0]).hypot(of_line[1] - spot[1])
    });
    each.fold(0.0, f64::max)
}

/// The map from metres to spots that a line gives if it is the path.
fn map_of(line: &[Point], path: &[Point]) -> Option<(f64, f64, f64)> {
    let length = |ends: [Point; 2]| (ends[1][0] - ends[0][0]).hypot(ends[1][1] - ends[0][1]);
    let ends = |points: &[Point]| Some([*points.first()?, *points.last()?]);
    let ([from, _], [start, _]) = (ends(path)?, ends(line)?);
    let scale = length(ends(line)?) / length(ends(path)?);
    Some((scale, start[0] - scale * from[0], start[1] + scale * from[1]))
}

/// The agents of a tick of JSON lines whose forecast moves: its position and best forecast.
fn paths_of(lines: &str, tick: usize) -> Vec<Vec<Point>> {
    let line: serde_json::Value = serde_json::from_str(lines.lines().nth(tick).unwrap()).unwrap();
    let point = |value: &serde_json::Value| [0, 1].map(|axis| value[axis].as_f64().unwrap());
    let path = |agent: &serde_json::Value| {
        let start = ["x_m", "y_m"].map(|axis| agent[axis].as_f64().unwrap());
        let steps = agent["best_m"].as_array().unwrap().iter().map(point);
        std::iter::once(start).chain(steps).collect::<Vec<_>>()
    };
    let paths = line["agents"].as_array().unwrap().iter().map(path);
    let length_m = |path: &Vec<Point>| (path[12][0] - path[0][0]).hypot(path[12][1] - path[0][1]);
    let mut paths: Vec<Vec<Point>> = paths.filter(|path| length_m(path) > 3.0).collect();
    // The longest path gives the scale: spots have two decimals.
    paths.sort_by(|a, b| length_m(b).total_cmp(&length_m(a)));
    paths
}

/// Asserts that a picture has the best forecast of every agent, all under one map.
fn assert_draws(svg: &str, paths: &[Vec<Point>]) {
    let lines: Vec<Vec<Point>> = lines_of(svg).into_iter().filter(|line| line.len() == 13).collect();
    assert!(paths.len() > 4 && lines.len() >= paths.len());
    // Of all ways in which a line can be the first path, one puts all others in their place.
    let maps = lines.iter().filter_map(|line| map_of(line, &paths[0]));
    let missing = |map: (f64, f64, f64)| {
        let is_drawn = |path: &&Vec<Point>| !lines.iter().any(|line| apart(line, path, map) < 0.06);
        paths.iter().filter(is_drawn).count()
    };
    let least = maps.map(missing).min();
    assert_eq!(least, Some(0), "forecasts that are not where they were published");
}

fn lab(arguments: &[&str]) {
    let output = Command::new(env!("CARGO_BIN_EXE_stgdat-lab")).args(arguments).output().unwrap();
    let error = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{arguments:?}: {error}");
}

/// Plays the generated intersection, and writes what it publishes as JSON lines and as a recording.
fn publish(lines: &str, record: &str) {
    let options = source::Options { agents: 16, ..source::Options::default() };
    let recording = source::recording(&options, WorldOrigin::default(), 1).unwrap();
    let playing = PlaybackOptions { ticks_max: Some(140), lockstep: true, ..PlaybackOptions::default() };
    let mut playback = Playback::new(recording, playing);
    let run = Run { lockstep: true, interval_ns: playback.interval_ns(), ..Run::default() };
    let mut chain = Chain::new(&run, Weights::onboard().config()).unwrap();
    let mut writer = ForecastWriter::create(Path::new(lines), WorldOrigin::default()).unwrap();
    let mut recorder = Writer::create(Path::new(record), &About::default(), "{}").unwrap();
    let mut number = 0;
    while let Some(tick) = playback.next_tick() {
        chain.tick(&tick.header, tick.detections, |_| ());
        let (tracks, forecasts) = chain.frames();
        let ((header, tracks), (of, forecasts)) = (tracks.parts(), forecasts.parts());
        writer.write(of, forecasts).unwrap();
        number += 2;
        recorder.frame(&Frame::of::<TracksTopic>(header, tracks, number));
        recorder.frame(&Frame::of::<ForecastsTopic>(of, forecasts, number + 1));
    }
    writer.finish().unwrap();
    recorder.finish("the end").unwrap();
}

#[test]
fn the_coordinates_of_a_picture_are_the_published_numbers() {
    let scratch = Scratch::new("pictures");
    let [lines, record, picture] = ["a.jsonl", "a.mcap", "a.svg"].map(|name| scratch.path(name));
    publish(&lines, &record);
    let paths = paths_of(&std::fs::read_to_string(&lines).unwrap(), 100);
    for source in [&lines, &record] {
        lab(&["plot", "scene", source, "--at", "8.01", "--out", &picture]);
        let svg = std::fs::read_to_string(&picture).unwrap();
        assert!(svg.contains("t = 8.00 s, tick 100"), "{source}");
        assert_draws(&svg, &paths);
    }
}

#[test]
fn the_picture_in_the_readme_is_what_its_command_prints() {
    let scratch = Scratch::new("readme-picture");
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../../..");
    let readme = std::fs::read_to_string(format!("{root}/README.md")).unwrap();
    let command = readme.split('`').find(|part| part.starts_with("stgdat plot scene")).unwrap();
    let picture = scratch.path("scene.svg");
    let arguments: Vec<&str> = command.split_whitespace().skip(1).collect();
    let place = arguments.iter().position(|argument| *argument == "--out").unwrap();
    let arguments = [&arguments[..=place], &[picture.as_str()], &arguments[place + 2..]].concat();
    lab(&arguments);
    let [printed, kept] = [picture, format!("{root}/docs/forecasts.svg")].map(std::fs::read_to_string);
    // Other processors round differently in the last place, which moves a spot by a hundredth of a point.
    let (printed, kept) = (printed.unwrap(), kept.unwrap());
    let (printed, kept) = (lines_of(&printed), lines_of(&kept));
    let moving =
        |lines: &[Vec<Point>]| lines.iter().filter(|line| line.len() == 13).cloned().collect::<Vec<_>>();
    let (printed, kept) = (moving(&printed), moving(&kept));
    assert!(printed.len() == kept.len() && kept.len() > 20, "{} and {}", printed.len(), kept.len());
    for (printed, kept) in printed.iter().zip(&kept) {
        assert!(apart(printed, &flipped(kept), (1.0, 0.0, 0.0)) < 0.05, "docs/forecasts.svg is out of date");
    }
}

/// Spots as points in metres with the y axis up.
fn flipped(line: &[Point]) -> Vec<Point> {
    line.iter().map(|[x, y]| [*x, -y]).collect()
}
