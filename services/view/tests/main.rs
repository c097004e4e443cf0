//! The live page in headless Chromium, used as a person uses it.
#![expect(clippy::unwrap_used, reason = "a test ends at what it can't do")]

use std::time::Duration;

use recorder::WorstTick;
use recorder::status::{RunStatus, StatusEvent};
use serde_json::json;
use testing::Browser;
use view::{Foresight, Live, Scene};
use wire::tick_view::TickView;
use wire::{Forecast, HORIZON_MAX, Header, Track};

const FIXTURE: &str = include_str!("fixture.js");
const DESKTOP: [u32; 2] = [1400, 900];
const PHONE: [u32; 2] = [390, 844];

/// The page of a run, with `ticks` ticks of the fixture.
fn open(name: &str, size: [u32; 2], ticks: u64) -> Option<(Live, Browser)> {
    let live = Live::serve("127.0.0.1:0".parse().unwrap(), r#"{"title":"a crossing","lanes":[]}"#).unwrap();
    let mut browser = Browser::open(name, &live.url(), size)?;
    browser.wait_for("live.hello");
    browser.value(FIXTURE);
    live.status(&serde_json::to_string(&status()).unwrap());
    browser.wait_for("live.status");
    browser.value(&format!("fixture.feed(0, {ticks})"));
    Some((live, browser))
}

fn status() -> RunStatus {
    let mut status = RunStatus { run: "test".into(), title: "a crossing".into(), ..RunStatus::default() };
    status.report.late_limit_ms = Some(80.0);
    status.report.worst_ticks = vec![WorstTick {
        tick: 130,
        end_to_end_ms: Some(95.0),
        cause: "the decoder computed 60 ms".into(),
        ..WorstTick::default()
    }];
    status.events.push(StatusEvent { elapsed_s: 3.0, text: "decoder: restarted".into() });
    status
}

fn number(browser: &mut Browser, expression: &str) -> f64 {
    browser.value(expression).as_f64().unwrap()
}

#[test]
fn a_person_goes_back_in_time_and_returns() {
    let Some((live, mut browser)) = open("time", DESKTOP, 0) else { return };
    let script = "fixture.feed(0, 900, (seq) => seq === 300 ? { scene: { l: 140 } } : seq >= 500 ? { scene: { r: { decoder: 1 } } } \
                  : seq === 130 ? { scene: { l: 95 } } : {})";
    browser.value(script);
    assert!(browser.text("#clock").starts_with("tick 899 · stamp 1071.920 s · 3 agents"));
    // Scrub 60 s back: 750 ticks of 80 ms.
    browser.value("document.querySelector('#scrub').value = 149; document.querySelector('#scrub').dispatchEvent(new Event('input'))");
    browser.wait_for("document.querySelector('#clock').innerText.startsWith('tick 149 ')");
    assert_eq!(browser.text("#when"), "−60.0 s");
    // A new tick does not move the shown one.
    browser.value("takeTick(fixture.tick(900))");
    assert!(browser.text("#clock").starts_with("tick 149 "));
    browser.press("ArrowRight");
    browser.wait_for("document.querySelector('#clock').innerText.startsWith('tick 150 ')");
    browser.press("ArrowLeft");
    browser.press("ArrowLeft");
    browser.wait_for("document.querySelector('#clock').innerText.startsWith('tick 148 ')");
    // The scene is the one of then.
    let there = format!(
        "fixture.isNear(fixture.pixel(fixture.tick(148).scene.agents[0].p, [-8, 0]), {})",
        color("none")
    );
    assert_eq!(browser.value(&there), true);
    // A late tick and a restart are marks.
    browser.click("#marks .late[data-ordinal='300']");
    browser.wait_for("document.querySelector('#clock').innerText.startsWith('tick 300 ')");
    browser.click("#marks .restart");
    browser.wait_for("document.querySelector('#clock').innerText.startsWith('tick 500 ')");
    browser.click("#worst button");
    browser.wait_for("document.querySelector('#clock').innerText.startsWith('tick 130 ')");
    browser.click("#live");
    browser.wait_for("document.querySelector('#clock').innerText.startsWith('tick 900 ')");
    assert_eq!(browser.text("#when"), "live");
    browser.click("#pause");
    browser.value("takeTick(fixture.tick(901))");
    browser.wait_for("document.querySelector('#clock').innerText.startsWith('tick 900 ')");
    // A new reason of the verdict is an alarm.
    let mut doubtful = status();
    doubtful.report.verdict.reasons = vec!["2 restarts".into()];
    live.status(&serde_json::to_string(&doubtful).unwrap());
    browser.wait_for("ring.tick(ring.newest).marks.length === 1");
    // The run ends, and the page stays.
    live.end(Duration::from_secs(30));
    browser.wait_for("!document.querySelector('#ended').hidden");
    assert!(browser.text("#ended").contains("ticks 0 to 901"), "{}", browser.text("#ended"));
    assert_eq!(browser.value("document.querySelector('#report').download"), "test.json");
    assert_eq!(browser.value("document.querySelector('#report').href.startsWith('blob:')"), true);
    browser.press("Home");
    browser.wait_for("document.querySelector('#clock').innerText.startsWith('tick 0 ')");
    // A reload has the same ticks, marks and report.
    browser.wait_for("live.kept");
    browser.call("Page.reload", json!({}));
    browser.wait_for("window.live && live.kept");
    assert!(browser.text("#ended").contains("ticks 0 to 901"), "{}", browser.text("#ended"));
    assert_eq!(browser.value("document.querySelector('#report').href.startsWith('blob:')"), true);
    browser.click("#marks .late[data-ordinal='300']");
    browser.wait_for("document.querySelector('#clock').innerText.startsWith('tick 300 ')");
    browser.value(FIXTURE);
    let drawn = format!(
        "fixture.isNear(fixture.pixel(fixture.tick(300).scene.agents[0].p, [-8, 0]), {})",
        color("none")
    );
    assert_eq!(browser.value(&drawn), true);
    assert!(browser.complaints().is_empty(), "{:?}", browser.complaints());
    let origin = live.url();
    for url in browser.requests() {
        assert!(url.starts_with(&origin) || url.starts_with("data:"), "{url} left the page");
    }
}

#[test]
fn the_memory_of_the_page_has_a_limit() {
    let Some((_live, mut browser)) = open("memory", DESKTOP, 0) else { return };
    let script = "(() => { const small = new Ring(120, 200000); let most = 0; for (let k = 0; k < 2000; k++) { \
                  small.push(fixture.tick(k).scene); most = Math.max(most, small.bytes); } \
                  return [most, small.ticks.length, small.newest, small.tick(small.first).seq, small.first]; })()";
    let kept = browser.value(script);
    assert!(kept[0].as_f64().unwrap() < 202_000.0 && kept[1].as_f64().unwrap() > 100.0, "{kept}");
    assert_eq!((kept[2].clone(), kept[3].clone()), (1999.into(), kept[4].clone()));
    // By time: 120 s are 1500 ticks.
    browser.value("fixture.feed(0, 2000)");
    assert_eq!(browser.value("ring.ticks.length"), 1501);
    // What is kept is what was sent.
    let script = "(() => { const sent = fixture.tick(1234).scene; const kept = ring.scene(1234); \
                  return sent.agents.every((agent, k) => Object.keys(agent).every((key) => \
                  JSON.stringify(agent[key]) === JSON.stringify(kept.agents[k][key]) || key === 'f' && \
                  Object.keys(agent.f).every((part) => JSON.stringify(agent.f[part]) === JSON.stringify(kept.agents[k].f[part])))); })()";
    assert_eq!(browser.value(script), true);
}

#[test]
fn the_view_follows_the_ego_or_the_agents() {
    let Some((_live, mut browser)) = open("view", DESKTOP, 1) else { return };
    assert_eq!(browser.value("document.querySelector('#ego').hidden"), true);
    // All agents drive 2 km away.
    let far = "{ extra: [fixture.agent(20, 0, [200000, 0], [0, 0], 0), fixture.agent(21, 0, [201000, 0], [0, 0], 0), \
               fixture.agent(22, 0, [201000, 900], [0, 0], 0), fixture.agent(23, 0, [202000, 0], [0, 0], 0)] }";
    browser.value(&format!("fixture.feed(1, 2, () => ({far}))"));
    let seen =
        "sceneCanvas.draw(), sceneCanvas.scene.agents.filter(({ p }) => sceneCanvas.isOnScreen(p, 0)).length";
    assert!(number(&mut browser, seen) >= 6.0, "the view fits again");
    // Nothing covers the scene.
    let covers = "(() => { const b = document.querySelector('#scene').getBoundingClientRect(); let other = 0; \
                  for (let x = b.left + 2; x < b.right; x += 12) for (let y = b.top + 2; y < b.bottom; y += 12) \
                  if (document.elementFromPoint(x, y) !== document.querySelector('#scene')) other++; return other; })()";
    for size in [DESKTOP, [768, 1024], PHONE] {
        browser.resize(size);
        browser.value("scrollTo(0, 0); document.querySelector('#layers-box').open = innerWidth > 500");
        let covered = number(&mut browser, covers);
        assert_eq!(covered, 0.0, "{size:?}");
    }
    let Some((_live, mut browser)) = open("ego", DESKTOP, 0) else { return };
    browser.value("fixture.feed(0, 2, (seq) => ({ ego: [50 + seq, 20, 0.5] }))");
    assert_eq!(browser.value("document.querySelector('#ego').getAttribute('aria-pressed')"), "true");
    browser.value("sceneCanvas.draw()");
    assert_eq!(browser.value("sceneCanvas.center.join(' ')"), "51 20");
}

#[test]
fn layers_can_be_switched() {
    let Some((_live, mut browser)) = open("layers", DESKTOP, 100) else { return };
    browser.value(
        "sceneCanvas.layers.places = sceneCanvas.layers.regions = sceneCanvas.layers.conflicts = false, showDetails()",
    );
    // The legend is smaller now, so the scene grows.
    browser.wait_for("sceneCanvas.height === sceneCanvas.canvas.clientHeight");
    let ground = "fixture.pixels('ffffff', 1)";
    let all = number(&mut browser, ground);
    browser.click("[data-layer=forecasts]");
    let without_best = number(&mut browser, ground);
    browser.click("[data-layer=modes]");
    let without_modes = number(&mut browser, ground);
    assert!(all < without_best && without_best < without_modes, "{all} {without_best} {without_modes}");
    // Modes below 2 % are hidden at first.
    browser.click("[data-layer=modes]");
    let probable = number(&mut browser, ground);
    browser.click("[data-layer=improbable]");
    assert!(number(&mut browser, ground) < probable, "improbable modes cover more of the ground");
    browser.click("[data-layer=regions]");
    browser.wait_for("sceneCanvas.layers.regions === document.querySelector('[data-layer=regions]').checked");
    // Where they went is known of the past.
    browser.value("goTo(20)");
    browser.click("[data-layer=truth]");
    browser.wait_for("sceneCanvas.later && sceneCanvas.later.get('11').length > 100");
}

#[test]
fn an_agent_is_searched_selected_and_explained() {
    let Some((_live, mut browser)) = open("search", DESKTOP, 60) else { return };
    assert_eq!(number(&mut browser, "document.querySelectorAll('#agents tr[data-id]').length"), 3.0);
    browser.click("#search");
    browser.insert("pedestrian");
    browser.wait_for("document.querySelectorAll('#agents tr[data-id]').length === 1");
    browser.click("#agents tr[data-id='13']");
    browser.wait_for("document.querySelector('#agent-name').innerText === 'pedestrian 13'");
    browser.value("document.querySelector('#search').value = '12'; document.querySelector('#search').dispatchEvent(new Event('input'))");
    browser.click("#agents tr[data-id='12']");
    browser.wait_for("document.querySelector('#agent-name').innerText === 'vehicle 12'");
    assert!(browser.text("#agent-facts").contains("8.0 m/s · kinematic"));
    assert_eq!(
        browser.text("#why").trim(),
        "Constant velocity was nearer for vehicles of this speed, so it has most of the weight (72 %): normal."
    );
    // Its forecasts of 1, 2 and 4 s ago: the fixture's agents keep their speed, so that no forecast is wrong.
    assert_eq!(browser.value("sceneCanvas.past.map(({ age }) => age)"), json!([1, 2, 4]));
    assert_eq!(browser.value("sceneCanvas.past.map(({ p }) => Math.abs(p[1] - sceneCanvas.scene.agents[1].p[1]) > 700).includes(false)"), false);
    assert!(number(&mut browser, "fixture.pixels(themed('select'), 60)") > 50.0);
    assert!(number(&mut browser, "ring.series('12').at(-1)[1].error") < 3.0);
    // A wrong forecast has its error: the car stops and is 16 m behind its forecast of 2 s ago.
    let stop = "fixture.feed(60, 100, () => ({ scene: { agents: [fixture.agent(12, 0, fixture.tick(59).scene.agents[1].p, [0, 0], 5)] } }))";
    browser.value(stop);
    let error = number(&mut browser, "ring.series('12').at(-16)[1].error");
    assert!((error - 1600.0).abs() < 80.0, "{error}");
    // Its forecast changes most at the tick at which it stops. A click on the peak goes there.
    let peak =
        "(() => { const jumps = jumpsOf(ring.series('12')); return jumps.indexOf(Math.max(...jumps)); })()";
    assert_eq!(number(&mut browser, peak), 60.0);
    browser.value(
        "(() => { const chart = document.querySelector('#agent-jump'); const [begin, end] = live.agentTimes; \
         const share = (ring.tick(60).s - begin) / (end - begin); const b = chart.getBoundingClientRect(); \
         const x = CHART_LEFT + share * (chart.clientWidth - CHART_LEFT - CHART_RIGHT); \
         chart.dispatchEvent(new MouseEvent('click', { clientX: b.x + x, clientY: b.y + 20, bubbles: true })); })()",
    );
    browser.wait_for("document.querySelector('#clock').innerText.startsWith('tick 60 ')");
    // The weights of now and of a second before.
    browser.wait_for(
        "document.querySelector('#agent-evidence').textContent.includes('constant velocity72 %72 %')",
    );
}

#[test]
fn a_finger_selects_a_person_on_a_phone() {
    let Some((_live, mut browser)) = open("phone", PHONE, 30) else { return };
    // A stage with all that its row can have.
    browser.value(
        "showStatus({ ...live.status, stages: [{ name: 'localiser', alive: false, budget_ms: 14.25, \
         recent_compute_ms: { p50: 12.34, p99: 45.67 }, process: { state: 'restarting', restarts: 12 } }] })",
    );
    assert_eq!(browser.value("document.documentElement.scrollWidth <= 390"), true, "nothing is cut off");
    let wide = "document.querySelector('#conflict-card').offsetWidth";
    assert!(number(&mut browser, wide) > 360.0, "the cards are as wide as the screen");
    let place = browser.value(
        "(() => { sceneCanvas.draw(); const [x, y] = sceneCanvas.toScreen(...sceneCanvas.scene.agents[2].p); \
         const b = document.querySelector('#scene').getBoundingClientRect(); return [b.x + x + 14, b.y + y + 14]; })()",
    );
    // The ring of the selection appears around this person, and around nobody else.
    let ring = |browser: &mut Browser, agent: usize| {
        let around = format!("[...fixture.tick(29).scene.agents[{agent}].p, 16]");
        number(browser, &format!("fixture.pixels(sceneCanvas.colors.select, 30, {around})"))
    };
    assert_eq!(ring(&mut browser, 2), 0.0);
    browser.tap_at([0, 1].map(|axis| place[axis].as_f64().unwrap()));
    browser.wait_for("sceneCanvas.selected === '13'");
    browser.wait_for("document.querySelector('#agent-name').innerText === 'pedestrian 13'");
    assert!(ring(&mut browser, 2) > 30.0, "the person has a ring");
    assert_eq!([0, 1].map(|agent| ring(&mut browser, agent)), [0.0; 2]);
    for button in ["#pause", "#back", "#forth", "#live"] {
        assert!(number(&mut browser, &format!("document.querySelector('{button}').offsetHeight")) >= 40.0);
    }
}

/// A car that keeps its velocity, with one mode.
fn car(id: u64, position_m: [f32; 2], velocity_mps: [f32; 2]) -> Forecast {
    let mut car = Forecast { id, modes_len: 1, length_m: 4.5, width_m: 1.9, ..Forecast::default() };
    ([car.x_m, car.y_m], [car.vx_mps, car.vy_mps]) = (position_m, velocity_mps);
    car.heading_rad = velocity_mps[1].atan2(velocity_mps[0]);
    car.probability[0] = 1.0;
    car.mode_covariance[0] = [[1.0, 0.0, 1.0]; HORIZON_MAX];
    for step in 0..HORIZON_MAX {
        let in_s = 0.4 * (step + 1) as f32;
        car.modes[0][step] = [0, 1].map(|axis| position_m[axis] + velocity_mps[axis] * in_s);
    }
    car.best = car.modes[0];
    car
}

/// The track of a car.
fn track(of: &Forecast) -> Track {
    let Forecast { id, x_m, y_m, vx_mps, vy_mps, heading_rad, length_m, width_m, .. } = *of;
    Track { id, x_m, y_m, vx_mps, vy_mps, heading_rad, length_m, width_m, ..Track::default() }
}

#[test]
fn conflicts_are_listed_with_the_ego_first() {
    let Some((live, mut browser)) = open("conflicts", DESKTOP, 0) else { return };
    // Two cars reach the crossing 0.2 s apart, at 10 m/s from 25 m away; a third one drives away. The ego drives at
    // a car that comes towards it.
    let mut foresight = Foresight::default();
    for k in 0..8_u64 {
        let cars = [
            car(1, [-25.0, 0.0], [10.0, 0.0]),
            car(2, [0.0, -27.0], [0.0, 10.0]),
            car(3, [20.0, 40.0], [0.0, 10.0]),
            car(4, [-30.0, 30.0], [-5.0, 0.0]),
        ];
        let mut header = Header { step_ns: 400_000_000, ..Header::new(1, k, k as i64 * 80_000_000) };
        (header.counts.history_len, header.counts.horizon_len) = (1, HORIZON_MAX as u32);
        (header.flags, header.ego_m) = (wire::flags::SEEN_FROM_EGO, [-60.0 + k as f32 * 0.8, 30.0]);
        let tick = TickView::new((&header, &cars.each_ref().map(track)), (&header, &cars));
        live.tick(&Scene::new(&tick, 20).foreseen(&tick, &foresight.of(&tick, &cars)).to_json());
        browser.wait_for(&format!("ring.ticks.length && ring.tick(ring.newest).seq === {k}"));
    }
    browser.wait_for("document.querySelectorAll('#conflicts tr[data-id]').length === 2");
    let first = browser.text("#conflicts tr[data-id]");
    assert!(first.starts_with("ego – vehicle 4") && first.ends_with("100 %"), "{first}");
    let rows = browser.value("ring.scene(ring.newest).k");
    assert_eq!(
        (&rows[0][0], &rows[0][1], &rows[1][0], &rows[1][1]),
        (&json!(-1), &json!(3), &json!(0), &json!(1))
    );
    let value = |row: usize, column: usize| rows[row][column].as_f64().unwrap();
    // Most drivers react.
    assert!((10.0..300.0).contains(&value(0, 2)) && (10.0..300.0).contains(&value(1, 2)), "{rows}");
    assert!((value(1, 4) - 2400.0).abs() < 410.0 && value(1, 5).hypot(value(1, 6)) < 400.0, "{rows}");
    // The agent that is nearest to the ego's path comes first, and a kept tick has what was sent.
    assert!(browser.text("#agents tr[data-id]").starts_with("4"));
    assert_eq!(browser.value("(ring.unpacked = { ordinal: -1 }, ring.scene(ring.newest).k)"), rows);
    assert!(browser.text("#conflicts tr:last-child").starts_with("vehicles 1 – 2"));
    assert_eq!(
        browser.value(
            "document.querySelector('aside').scrollWidth <= document.querySelector('aside').clientWidth"
        ),
        true
    );
    // A row may be drawn again between finding and clicking it, so the page does both.
    browser.value("document.querySelector('#conflicts tr[data-id=\"1\"]').click()");
    browser.wait_for("sceneCanvas.selected === '1' && document.querySelector('#ego').getAttribute('aria-pressed') === 'false'");
    // The ruler measures in the world.
    browser.click("#ruler");
    browser.value("sceneCanvas.ruler = [[0, 0], [300, 400]]; sceneCanvas.draw()");
    assert_eq!(browser.value("sceneCanvas.measured"), 5.0);
}

/// The colour of a cause in the light theme, as a JavaScript string.
fn color(cause: &str) -> serde_json::Value {
    let look = wire::vocabulary::LOOKS.iter().find(|look| look.cause.name() == cause).unwrap();
    let [red, green, blue] = look.light;
    format!("#{red:02x}{green:02x}{blue:02x}").into()
}
