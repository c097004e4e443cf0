//! Measures the live page in headless Chromium: `page_speed` prints how fast it draws while a person scrubs, and
//! `page_speed memory` the memory of an hour.
#![expect(clippy::print_stdout, clippy::unwrap_used, reason = "a measurement on the console")]

use serde_json::json;
use testing::Browser;
use view::Live;

/// Defines `ticks(from, to, agents)`: agents of the tests' fixture with 20 modes each, on a square of 120 m.
const TICKS: &str = "window.ticks = (from, to, agents) => { for (let seq = from; seq < to; seq++) { \
    const extra = Array.from({ length: agents - 3 }, (_, k) => { const angle = k * 2.4; const v = k % 3 ? 130 : 900; \
      const speed = [v * Math.cos(angle), v * Math.sin(angle)]; const phase = (seq % 120) * 0.08; \
      const at = [k * 97 % 120 - 60, k * 53 % 120 - 60].map((m, axis) => m * 100 + speed[axis] * phase); \
      const modes = Array.from({ length: 20 }, (_, mode) => [mode ? 30 : 430, Array.from({ length: 24 }, (_, at) => \
        Math.round(speed[at % 2] * 0.4 * ((at >> 1) + 1) * (1 + (mode - 10) / 40) + (at % 2 ? mode : -mode) * at))]); \
      return fixture.agent(100 + k, k % 3 ? 2 : 0, at, speed, k % 7 ? 0 : 5, { modes }); }); \
    takeTick(fixture.tick(seq, { extra })); } showDetails(); }";

/// Scrubs for five seconds: one tick for each frame. The result is in frames per second.
const SCRUB: &str = "(async () => { const frame = () => new Promise((next) => requestAnimationFrame(next)); \
    const [begun, draws] = [performance.now(), sceneCanvas.draws]; let at = ring.newest; \
    while (performance.now() - begun < 5000) { at = at > ring.first ? at - 1 : ring.newest; goTo(at); await frame(); } \
    return 1000 * (sceneCanvas.draws - draws) / (performance.now() - begun); })()";

/// Ticks of an hour.
const HOUR: u64 = 45_000;
/// Ticks between two measurements.
const PART: u64 = 4_500;

fn main() {
    let live = Live::serve("127.0.0.1:0".parse().unwrap(), r#"{"title":"speed","lanes":[]}"#).unwrap();
    let Some(mut browser) = Browser::open("page-speed", &live.url(), [1400, 900]) else { return };
    browser.wait_for("live.hello");
    browser.value(include_str!("../tests/fixture.js"));
    browser.value(TICKS);
    if std::env::args().nth(1).as_deref() == Some("memory") {
        for from in (0..HOUR).step_by(PART as usize) {
            // In small parts, so that the page draws in between.
            (from..from + PART).step_by(50).for_each(|at| {
                browser.value(&format!("ticks({at}, {}, 64)", at + 50));
            });
            browser.call("HeapProfiler.collectGarbage", json!({}));
            let heap = browser.call("Runtime.getHeapUsage", json!({}));
            let sum = heap["usedSize"].as_f64().unwrap() + heap["backingStorageSize"].as_f64().unwrap_or(0.0);
            println!("after {:2} min: {:.1} MB", (from + PART) * 2 / 25 / 60, sum / 1e6);
        }
        return;
    }
    for agents in [32, 64, 128] {
        browser.value(&format!("goTo(null); ticks(0, 300, {agents})"));
        println!("{agents} agents: {:.1} frames a second", browser.value(SCRUB).as_f64().unwrap());
    }
}
