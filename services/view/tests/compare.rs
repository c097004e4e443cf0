//! The page of two runs, and the graph of the pipeline, in headless Chromium.
#![expect(clippy::unwrap_used, reason = "a test ends at what it can't do")]

use recorder::Report;
use serde_json::{Value, json};
use testing::{Browser, Scratch};

const FIXTURE: &str = include_str!("fixture.js");
const DESKTOP: [u32; 2] = [1400, 900];

/// Opens the page of two reports.
fn open(name: &str, reports: [Report; 2]) -> Option<Browser> {
    let scratch = Scratch::new(name);
    let runs = reports.map(|report| view::RunPage::of_report(report.stgdat_version.clone(), report));
    let url = format!("file://{}", scratch.file("two.html", view::html(&runs)));
    let mut browser = Browser::open(name, &url, DESKTOP)?;
    browser.wait_for("document.body.dataset.ready");
    browser.value(FIXTURE);
    Some(browser)
}

/// Reports of two builds, of which the second is slower.
fn reports() -> [Report; 2] {
    let mut reports = [Report::default(), Report::default()];
    for (report, (version, p99)) in reports.iter_mut().zip([("1.0", 10.0), ("1.1", 13.0)]) {
        report.stgdat_version = version.into();
        report.end_to_end_ms.p99 = Some(p99);
    }
    reports
}

/// Scenes of ten cars at 10 m/s. Forecasts of A are short by 1 m at each step, forecasts of B by 0.9 m.
const SCENES: &str = "(() => { const frames = (error) => Array.from({ length: 100 }, (_, k) => ({ seq: k, t: k * 0.08, ego: null, \
     agents: Array.from({ length: 10 }, (_, car) => ({ i: `${car}`, n: `${car}`, t: 0, s: [0, 0], u: 0, y: [], v: [0, 0], \
     p: [k * 80, car * 400], h: 0, f: { q: 0, c: 0, a: 0, b: Array.from({ length: 12 }, (_, s) => [400 * (s + 1) - error * (car === 7 ? 3 : 1), 0]).flat(), \
     m: [], e: [], x: [], o: 0 } })) })); \
     RUNS[0].options = {}; RUNS[1].options = { 'sampler.evidence': 'false' }; \
     RUNS[0].unpacked.frames = frames(100); RUNS[1].unpacked.frames = frames(90).slice(0, 95); \
     document.querySelector('#compare').remove(); const card = comparison(RUNS); \
     document.querySelector('#runs').before(card); comparedScene(card, RUNS); window.sceneCanvas = scenes.at(-1); })()";

fn number(browser: &mut Browser, expression: &str) -> f64 {
    browser.value(expression).as_f64().unwrap()
}

fn verdict(browser: &mut Browser, of: &str) -> String {
    browser.value(of).as_str().unwrap().to_owned()
}

#[test]
fn two_runs_have_a_verdict_and_the_largest_difference() {
    let Some(mut browser) = open("compare", reports()) else { return };
    assert!(browser.text("#compared").starts_with("P99 3.00 ms longer."), "{}", browser.text("#compared"));
    // What differs comes first of all.
    assert_eq!(browser.value("document.querySelector('#compare').firstElementChild.id"), "differs");
    assert!(browser.text("#differs").contains("build\t1.0\t1.1"), "{}", browser.text("#differs"));
    browser.value(SCENES);
    let all = browser.text("#compared");
    assert!(
        all.starts_with("B is better by 10.0 % (10.0 to 10.0) for vehicles; p99 3.00 ms longer."),
        "{all}"
    );
    let differs = browser.text("#differs");
    assert!(differs.contains("sampler.evidence\tdefault\tfalse"), "{differs}");
    let same = browser.text("#differs");
    assert!(!same.contains("are the same"), "{same}");
    let sliders = "document.querySelectorAll('input[type=range]').length";
    assert_eq!(number(&mut browser, sliders), 1.0, "one slider");
    assert!(browser.text("#largest tr[data-place]").starts_with("vehicle 7"));
    let close = "verdictOn(0, Array.from({ length: 9 }, (_, k) => ({ a: 1 + k, b: 1.001 + k, count: 1 })))";
    assert_eq!(verdict(&mut browser, close), "no difference for vehicles");
    let unclear =
        "verdictOn(1, Array.from({ length: 9 }, (_, k) => ({ a: 1, b: k % 2 ? 1.2 : 0.84, count: 1 })))";
    let unclear = verdict(&mut browser, unclear);
    assert!(
        unclear.starts_with("no clear difference for cyclists: 0.0 % (−") && unclear.contains(" to +"),
        "{unclear}"
    );
    let row = browser.value("comparedRow('x', 1, 1.0001, 3) + comparedRow('y', 2, 1.5, 1)");
    assert_eq!(
        row,
        "<tr><td>x</td><td>1.000</td><td>1.000</td><td>0.000</td></tr><tr><td>y</td><td>2.0</td><td>1.5</td><td>−0.5</td></tr>"
    );
    browser.click("#largest tr[data-place]");
    browser.click("[data-truth]");
    browser.wait_for("scenes.at(-1).selected === '7' && scenes.at(-1).later.get('7').length > 20 && scenes.at(-1).past.length === 10");
    assert!(browser.complaints().is_empty(), "{:?}", browser.complaints());
}

#[test]
fn both_runs_are_drawn_over_each_other() {
    let Some(mut browser) = open("compare-pixels", reports()) else { return };
    browser.value(SCENES);
    browser.value("sceneCanvas.go(50)");
    // The ends of the forecasts of car 3: a disc of A's cause, and a ring of B over it.
    let at_end = |browser: &mut Browser, place: u32, color: &str| {
        let end = format!("[{place} * 80 + 4800 - 95, 3 * 400, 9]");
        number(browser, &format!("fixture.pixels({color}, 60, {end})"))
    };
    let of_a = "themed('cause-none')";
    let of_b = "fixture.over(sceneCanvas.colors.select, sceneCanvas.colors.ground, 0.75)";
    assert!(at_end(&mut browser, 50, of_a) > 5.0, "A is drawn");
    assert!(at_end(&mut browser, 50, of_b) > 5.0, "B is drawn over A");
    let everywhere =
        |browser: &mut Browser, color: &str| number(browser, &format!("fixture.pixels({color}, 60)"));
    let over_a = "fixture.over(sceneCanvas.colors.select, themed('cause-none'), 0.75)";
    let [a, b, both] = [of_a, of_b, over_a].map(|color| everywhere(&mut browser, color));
    // Dashes of B over ten lines of A, and the rings beside their discs.
    assert!(a > 500.0 && b > 50.0 && both > 300.0, "{a}, {b} and {both} pixels");
    // B has ended 5 ticks before A.
    browser.value("sceneCanvas.go(97)");
    assert_eq!(everywhere(&mut browser, of_b), 0.0);
    assert!(at_end(&mut browser, 97, of_a) > 5.0, "A goes on");
    // Where the agents went, on demand.
    browser.value("sceneCanvas.go(20)");
    let went = "fixture.over(sceneCanvas.colors.ink, sceneCanvas.colors.ground, 0.75)";
    // Car 7 continued for 3 m from the end of its forecast.
    let along = format!("fixture.pixels({went}, 60, [20 * 80 + 4800 - 60, 7 * 400, 4])");
    assert_eq!(number(&mut browser, &along), 0.0);
    browser.click("[data-truth]");
    browser.wait_for("sceneCanvas.later");
    assert!(number(&mut browser, &along) > 0.0, "the line of where the car went");
    // A click on the largest difference marks its agent.
    browser.click("#largest tr[data-place]");
    browser.wait_for("sceneCanvas.selected === '7'");
    let ring = "fixture.pixels(sceneCanvas.colors.select, 60, [...sceneCanvas.scene.agents[7].p, 30])";
    assert!(number(&mut browser, ring) > 30.0, "the selected agent has a ring");
}

/// A graph of a report, drawn at each width: what `found` makes of its `svg`.
fn drawn(browser: &mut Browser, report: &Value, widths: &[u32], found: &str) -> Value {
    let script = format!(
        "{widths:?}.map((width) => {{ const place = document.createElement('div'); place.innerHTML = graphOf({report}, width); \
         const svg = place.firstChild; const words = (of, between) => [...svg.querySelectorAll(of)].map((text) => text.textContent).join(between); \
         return {found}; }})"
    );
    browser.value(&script)
}

fn stage(name: &str, reads: &[&str], writes: &[&str], program: &str) -> Value {
    let times = |p50, p99| json!({ "p50": p50, "p99": p99 });
    json!({
        "name": name, "reads": reads, "writes": writes, "program": program, "budget_ms": 6, "restarts": 0,
        "compute_ms": times(Some(1.0), Some(9.0)), "waiting_ms": times(Some(0.1), Some(0.2)),
        "wake_up_ms": times(Some(0.03), Some(0.4)), "drops": { "gap": 0, "refused": 0, "restart": 0 },
    })
}

#[test]
fn arrows_have_waiting_wake_up_and_losses() {
    let Some(mut browser) = open("graph", reports()) else { return };
    let mut stages = [
        stage("source", &[], &["detections"], ""),
        stage("tracker", &["detections", "forecasts"], &["tracks"], ""),
        stage("sampler", &["tracks"], &["forecasts"], ""),
    ];
    stages[2]["drops"] = json!({ "gap": 3, "refused": 1, "restart": 7 });
    stages[2]["restarts"] = 2.into();
    let report = json!({ "stages": stages });
    let found = "[words('text', ' | '), [...svg.querySelectorAll('path[data-topic]')].map((path) => \
                 [path.dataset.topic, path.getAttribute('stroke'), path.getAttribute('stroke-dasharray')]), words('[data-stage=sampler] text', ' | ')]";
    let drawn = drawn(&mut browser, &report, &[900, 330], found);
    for of_width in drawn.as_array().unwrap() {
        let arrows = of_width[1].as_array().unwrap();
        let arrow = |topic: &str| arrows.iter().find(|arrow| arrow[0] == topic).unwrap();
        // Losses are red. The next tick is dashed.
        let soft = |topic: &str, dash: Value| json!([topic, "var(--soft)", dash]);
        assert_eq!(arrows.len(), 3, "{of_width}");
        assert_eq!(*arrow("tracks"), json!(["tracks", "var(--bad)", null]));
        assert_eq!(*arrow("detections"), soft("detections", Value::Null));
        assert_eq!(*arrow("forecasts"), soft("forecasts", "4 3".into()));
        let words = of_width[0].as_str().unwrap();
        assert!(words.contains("tracks | waiting | 0.10 / 0.20 | wake-up | 0.03 / 0.40 | 4 lost"), "{words}");
        assert!(words.contains("detections | waiting | 0.10 / 0.20 | wake-up | 0.03 / 0.40"), "{words}");
        assert_eq!(words.matches("waiting").count(), 2, "only where a tick arrives: {words}");
        assert_eq!(of_width[2], "sampler | 1.00 / 9.00 of 6.00 ms | 2 restarts, 7 lost");
    }
}

#[test]
fn partners_are_outside_with_the_time_since_the_stamp() {
    let Some(mut browser) = open("partners", reports()) else { return };
    let mut stages = [
        stage("source", &[], &["detections"], "stgdat-bridge"),
        stage("tracker", &["detections"], &["tracks"], ""),
        stage("sampler", &["tracks"], &["forecasts"], ""),
        stage("ros2", &["forecasts"], &[], "stgdat-ros2"),
        stage("bridge", &["forecasts"], &[], "stgdat-bridge"),
    ];
    for added in &mut stages[3..] {
        added["compute_ms"] = json!({ "p50": null, "p99": null });
    }
    stages[3]["since_stamp_ms"] = json!({ "p50": 22, "p99": 41 });
    let links = json!({ "source": { "frames": 1200 }, "ros2": { "frames": 910 }, "bridge": { "frames": 900, "lost": 3 } });
    let report = json!({ "stages": stages, "links": links, "since_stamp_ms": { "p50": 21, "p99": 40 } });
    let found = "[[...svg.querySelectorAll('[data-partner]')].map((box) => [...box.querySelectorAll('text')].map((text) => text.textContent).join(' | ')).sort().join('; '), \
                 svg.viewBox.baseVal.width <= width, new Set([...svg.querySelectorAll('g')].map((g) => g.getAttribute('transform').split(' ')[0])).size, words('text', ' ')]";
    let drawn = drawn(&mut browser, &report, &[900, 330], found);
    let boxes = "ROS 2 | 910 frames; other box | 1,200 frames; other box | 900 frames | 3 links lost; publication | 21.0 / 40.0 ms | since the stamp";
    for of_width in drawn.as_array().unwrap() {
        assert_eq!((&of_width[0], &of_width[1]), (&json!(boxes), &json!(true)), "{of_width}");
        let words = of_width[3].as_str().unwrap();
        assert!(words.contains("since stamp 22.0 / 41.0"), "{words}");
    }
    assert_eq!(drawn[1][2], 1, "on a phone, the boxes are in a column");
}
