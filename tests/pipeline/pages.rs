//! The live page and the report page, in headless Chromium if it is installed.

use std::io::{BufRead as _, BufReader, Write as _};
use std::net::TcpStream;
use std::path::Path;
use std::process::Stdio;

use rustix::process::Signal;
use testing::Scratch;

use crate::started::{Started, assert_nothing_left, piped, run, run_well, stderr, stdout, stgdat, wait_for};

/// Chromium that has opened a page.
struct Browser {
    process: Started,
    url: String,
    log: String,
}

impl Browser {
    /// Opens a page, with a log of the network; `None` if Chromium is not installed.
    fn open(scratch: &Scratch, url: &str, width: u32, more: &[&str]) -> Option<Self> {
        let chromium = std::env::var("STGDAT_CHROMIUM").unwrap_or_else(|_| "chromium".into());
        if let Err(error) = piped(&chromium).arg("--version").output() {
            testing::skip(format_args!("{chromium}: {error} (STGDAT_CHROMIUM names another program)"));
            return None;
        }
        let [log, profile] = ["log", "profile"].map(|name| scratch.path(&format!("{name}-{width}")));
        let fixed = ["--headless=new", "--no-sandbox", "--disable-gpu", "--disable-background-networking"];
        let mut command = piped(&chromium);
        command.args(fixed).args(["--no-first-run", "--disable-component-update", "--dump-dom"]);
        command.arg(format!("--window-size={width},900")).arg(format!("--user-data-dir={profile}"));
        // Chromium itself would look for updates and the like.
        command.arg("--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1");
        // Virtual time stands still while a request is open.
        command.arg(format!("--log-net-log={log}")).arg("--virtual-time-budget=10000").args(more).arg(url);
        Some(Self { process: Started::spawn(&mut command), url: url.to_owned(), log })
    }

    /// The page's elements after its scripts. Asserts that no request has left the page.
    fn dom(self) -> String {
        let dom = stdout(&self.process.output());
        let log = std::fs::read_to_string(self.log).expect("the log is text");
        let origin = self.url.split('/').take(3).collect::<Vec<_>>().join("/");
        // A page's requests have the page as their initiator; Chromium's own requests have none.
        for line in log.lines().filter(|line| line.contains("\"initiator\"") && line.contains("\"url\"")) {
            let is_of_browser = line.contains("\"initiator\":\"not an origin\"");
            let is_own = line.contains(&format!("\"url\":\"{origin}"));
            assert!(is_of_browser || is_own, "a request left the page: {line}");
        }
        dom
    }
}

/// The value of an attribute of the first element that has it.
fn attribute<'a>(dom: &'a str, name: &str) -> &'a str {
    let begin = dom.find(&format!("{name}=\"")).unwrap_or_else(|| panic!("no {name} in {dom}"));
    dom[begin + name.len() + 2..].split('"').next().unwrap_or_default()
}

/// The URL that `view` prints.
fn url_of(process: &mut Started) -> String {
    process.line().split_whitespace().next().unwrap_or_default().to_owned()
}

#[test]
fn the_live_page_shows_a_run_and_its_end() {
    let scratch = Scratch::new("live-page");
    let run = Started::run(&["--agents", "12", "--ticks", "300", "--quiet"]);
    let root = run.wait_until_it_runs();
    let mut view = Started::spawn(stgdat().args(["view", "--address", "0", "--run"]).arg(&root));
    let url = url_of(&mut view);
    assert!(url.starts_with("http://127.0.0.1:"), "{url}");
    let browsers = [1400, 700].map(|width| Browser::open(&scratch, &url, width, &[]));
    let output = run.output();
    assert!(output.status.success(), "{}", stderr(&output));
    assert_nothing_left(&root);
    let doms: Vec<String> = browsers.into_iter().flatten().map(Browser::dom).collect();
    // It stays for those who have watched.
    if doms.is_empty() {
        assert!(view.output().status.success(), "the view ends with its run");
    } else {
        assert!(view.line().contains("has ended; the page stays until Ctrl-C"));
        view.signal(Signal::INT);
        assert!(view.output().status.success());
    }
    for dom in doms {
        assert!(dom.contains("generated intersection, 12 agents"), "the title is missing: {dom}");
        for stage in ["tracker", "localiser", "extractor", "encoder", "decoder", "sampler"] {
            assert!(dom.contains(&format!("<td>{stage}</td>")), "{stage}");
        }
        let number = |name: &str| attribute(&dom, name).parse::<u64>().unwrap();
        assert!(number("data-ticks") > 5 && number("data-draws") > 0 && number("data-agents") > 3);
        assert!(dom.contains("<div id=\"ended\"><b>The run has ended</b>"), "the page says so");
        assert!(dom.contains("download=\""), "the report is offered");
    }
}

#[test]
fn browsers_that_come_and_go_leave_nothing() {
    let mut run = Started::run(&["--agents", "8", "--quiet", "--view", "0"]);
    let root = run.wait_until_it_runs();
    let url = url_of(&mut run);
    let address = url.trim_start_matches("http://").trim_end_matches('/').to_owned();
    // A browser that is gone keeps its connection until the server writes to it, and tries again if it finds
    // none that is free.
    let open = || {
        let mut stream = TcpStream::connect(&address).ok()?;
        write!(stream, "GET /events HTTP/1.1\r\nHost: {address}\r\n\r\n").ok()?;
        let mut lines = BufReader::new(stream).lines().map_while(Result::ok);
        lines.next().filter(|line| line.ends_with("200 OK")).map(|_| lines)
    };
    let descriptors = || ["tap", "view"].map(|verb| run.descriptors(verb));
    // The tap joins the run for its first reader and stays.
    let mut first = wait_for("no connection is free", open);
    assert!(first.any(|line| line == "event: tick"));
    let attached = descriptors();
    drop(first);
    let fewer = || Some(descriptors()).filter(|now| now[0] < attached[0] && now[1] < attached[1]);
    let detached = wait_for("the first browser is still attached", fewer);
    let mut ticks = 0;
    for number in 0..100 {
        let mut lines = wait_for("no connection is free", open);
        // Every fourth browser leaves before it has read anything.
        if number % 4 > 0 {
            ticks += u64::from(lines.any(|line| line == "event: tick"));
        }
    }
    assert!(ticks > 0);
    let same = || descriptors().iter().zip(detached).all(|(now, then)| *now <= then).then_some(());
    wait_for("descriptors are left over", same);
    run.signal(Signal::INT);
    let output = run.output();
    assert_eq!(output.status.code(), Some(130), "{}", stderr(&output));
    assert_nothing_left(&root);
}

/// Ctrl-C at the terminal of `script`, whose standard input is the terminal's keyboard.
#[test]
fn at_a_terminal_the_page_stays_until_ctrl_c() {
    let program = env!("CARGO_BIN_EXE_stgdat");
    // The condition holds, so the run's own code is 70.
    let condition = "--fail-if 'end_to_end_p99 > 0 ms'";
    let line = format!("exec {program} run --agents 8 --ticks 60 --quiet --view 0 {condition}");
    let mut command = piped("script");
    command.args(["--quiet", "--flush", "--return", "--command", &line, "/dev/null"]).env_remove("CI");
    command.stdin(Stdio::piped());
    if let Err(error) = piped("script").arg("--version").output() {
        testing::skip(format_args!("script: {error}: install util-linux"));
        return;
    }
    let mut terminal = Started::spawn(&mut command);
    let mut line_with = |text: &str| loop {
        let line = terminal.line();
        assert!(!line.is_empty(), "the output ends before {text}");
        if line.contains(text) {
            break line;
        }
    };
    let line = line_with("http://");
    let url = line.split_whitespace().find(|word| word.starts_with("http://")).expect("a URL");
    let address = url.trim_start_matches("http://").trim_end_matches('/').to_owned();
    let receives = |event: &str| {
        let mut stream = TcpStream::connect(&address).expect("the page is served");
        write!(stream, "GET /events HTTP/1.1\r\nHost: {address}\r\n\r\n").expect("it reads");
        BufReader::new(stream).lines().map_while(Result::ok).any(|line| line == event)
    };
    assert!(receives("event: end"), "a browser that has watched receives the end");
    line_with("error: --fail-if");
    line_with("The run has ended; the page stays until Ctrl-C");
    // A reload gets the newest tick and the end.
    assert!(receives("event: tick") && receives("event: end"));
    terminal.press(b"\x03");
    let output = terminal.output();
    assert_eq!(output.status.code(), Some(70), "{}", stdout(&output));
}

#[test]
fn the_report_page_has_verdict_scenes_and_worst_ticks() {
    let scratch = Scratch::new("report-page");
    let [page, report, record] = ["a.html", "a.json", "a.mcap"].map(|name| scratch.path(name));
    let scene = ["run", "--agents", "12", "--ticks", "150", "--speed", "max", "--quiet"];
    run_well(&[&scene[..], &["--html", &page, "--report", &report, "--record", &record]].concat());
    let html = scratch.read("a.html");
    assert!(html.len() < view::PAGE_BYTES);
    let text = String::from_utf8_lossy(&html);
    assert!(!text.contains("https://") && !text.contains("src=") && !text.contains("@import"));
    for (width, more) in [(1300, &[][..]), (480, &["--blink-settings=preferredColorScheme=0"][..])] {
        let url = format!("file://{page}");
        let Some(browser) = Browser::open(&scratch, &url, width, more) else { return };
        let dom = browser.dom();
        assert_eq!(attribute(&dom, "data-ready"), "true");
        let draws: Vec<u64> = attribute(&dom, "data-scenes").split(' ').map(|n| n.parse().unwrap()).collect();
        assert!(draws.len() > 3 && draws.iter().all(|draws| *draws > 0), "{draws:?}");
        assert!(dom.contains("tick 75 · 6.0 s · "), "the scene in the middle of the run");
        for part in
            ["class=\"verdict", "Worst ticks", "Accuracy and calibration by horizon", "data-stage=\"5\""]
        {
            assert!(dom.contains(part), "{part}");
        }
    }
}

#[test]
fn the_page_of_a_played_recording_has_no_latencies() {
    let scratch = Scratch::new("played-page");
    let [page, lines] = ["a.html", "a.jsonl"].map(|name| scratch.path(name));
    run_well(&["predict", "--ticks", "120", "--out", &lines, "--html", &page]);
    assert!(scratch.read("a.html").len() < view::PAGE_BYTES);
    let folder = Path::new(&page).parent().expect("a folder");
    let files = std::fs::read_dir(folder).expect("the folder exists").flatten();
    assert!(
        !files.into_iter().any(|file| file.file_name().to_string_lossy().ends_with(".mcap")),
        "it is temporary"
    );
    let Some(browser) = Browser::open(&scratch, &format!("file://{page}"), 1300, &[]) else { return };
    let dom = browser.dom();
    for part in
        ["tick 60 · 4.8 s · 32 agents", "Accuracy against the truth", "Forecasts by quality and cause"]
    {
        assert!(dom.contains(part), "{part}");
    }
    let body = &dom[dom.find("<article").expect("a run")..];
    let (body, _) = body.split_once("<script>").expect("the scripts come last");
    for part in ["<h2>Worst ticks", "<h2>End to end", "<h2>Stages", "end to end p50"] {
        assert!(!body.contains(part), "{part}");
    }
}

/// The scenes that the page unpacks are the published tracks and forecasts, to the centimetre.
#[test]
fn the_report_page_unpacks_the_published_numbers() {
    let scratch = Scratch::new("report-numbers");
    let [page, lines] = ["a.html", "a.jsonl"].map(|name| scratch.path(name));
    let scene = ["run", "--agents", "6", "--ticks", "60", "--speed", "max", "--quiet"];
    run_well(&[&scene[..], &["--html", &page, "--forecasts", &lines]].concat());
    let published = String::from_utf8(scratch.read("a.jsonl")).unwrap();
    let published: serde_json::Value = serde_json::from_str(published.lines().nth(41).unwrap()).unwrap();
    let script = "<script>addEventListener(\"load\", async () => { while (!document.body.dataset.ready) await new \
                  Promise((next) => setTimeout(next, 20)); document.body.dataset.numbers = \
                  JSON.stringify(RUNS[0].unpacked.frames[41]).replaceAll('\"', \"'\"); });</script></body>";
    let html = String::from_utf8(scratch.read("a.html")).unwrap().replace("</body>", script);
    let probe = scratch.path("probe.html");
    std::fs::write(&probe, html).unwrap();
    let url = format!("file://{probe}");
    let Some(browser) = Browser::open(&scratch, &url, 1300, &[]) else { return };
    let dom = browser.dom();
    let unpacked: serde_json::Value =
        serde_json::from_str(&attribute(&dom, "data-numbers").replace('\'', "\"")).unwrap();
    assert_eq!(unpacked["seq"], 41);
    let agents = published["agents"].as_array().unwrap();
    assert!(agents.len() > 2 && unpacked["agents"].as_array().map(Vec::len) == Some(agents.len()));
    for (agent, drawn) in agents.iter().zip(unpacked["agents"].as_array().unwrap()) {
        assert_eq!(agent["id"].to_string(), drawn["i"].as_str().unwrap());
        let near = |value: &serde_json::Value, centimetres: f64| {
            let metres = value.as_f64().unwrap();
            assert!((metres * 100.0 - centimetres).abs() <= 0.51, "{metres} m and {centimetres} cm");
        };
        let place = |axis: usize| drawn["p"][axis].as_f64().unwrap();
        near(&agent["x_m"], place(0));
        near(&agent["y_m"], place(1));
        let best = agent["best_m"].as_array().unwrap();
        assert_eq!(drawn["f"]["b"].as_array().map(Vec::len), Some(2 * best.len()));
        for (step, point) in best.iter().enumerate() {
            for axis in 0..2 {
                near(&point[axis], place(axis) + drawn["f"]["b"][2 * step + axis].as_f64().unwrap());
            }
        }
    }
}

#[test]
fn two_runs_are_side_by_side_and_a_report_alone_is_enough() {
    let scratch = Scratch::new("report-two");
    let [a, b, page] = ["a.mcap", "b.json", "two.html"].map(|name| scratch.path(name));
    let scene = ["run", "--agents", "5", "--ticks", "40", "--speed", "max", "--quiet"];
    run_well(&[&scene[..], &["--record", &a]].concat());
    run_well(&[&scene[..], &["--seed", "2", "--report", &b]].concat());
    run_well(&["report", &a, &b, "--out", &page]);
    assert!(scratch.read("two.html").len() < view::PAGE_BYTES);
    for again in [&["report", &a, &b, "--out", &page][..], &["run", "--ticks", "5", "--html", &page]] {
        let refused = run(again);
        assert!(stderr(&refused).contains("--force") && !refused.status.success(), "{}", stderr(&refused));
    }
    run_well(&["report", &a, &b, "--out", &page, "--force"]);
    // `diff` writes the same page of two files of a kind.
    let [second, of_diff] = ["b.mcap", "diff.html"].map(|name| scratch.path(name));
    let other = ["--seed", "2", "--set", "sampler.evidence=false", "--record", &second];
    run_well(&[&scene[..], &other].concat());
    let differ = run(&["diff", &a, &second, "--html", &of_diff]);
    for what in ["seed: 1 and 2", "sampler.evidence: default and false"] {
        assert!(stdout(&differ).contains(&format!("the runs differ in {what}\n")), "{}", stdout(&differ));
    }
    run_well(&["report", &a, &second, "--out", &scratch.path("of-report.html")]);
    assert_eq!(scratch.read("diff.html"), scratch.read("of-report.html"));
    assert!(stderr(&run(&["diff", &a, &second, "--html", &of_diff])).contains("--force"));
    let refused = run(&["report", &scratch.path("missing.mcap")]);
    assert!(!refused.status.success() && stderr(&refused).contains("missing.mcap"));
    let url = format!("file://{page}");
    let Some(browser) = Browser::open(&scratch, &url, 1700, &[]) else { return };
    let dom = browser.dom();
    assert_eq!(dom.matches("<article class=\"run\"><header>").count(), 2);
    assert!(dom.contains("class=\"two\"") && dom.contains("seed 1") && dom.contains("seed 2"));
    // The recording has no report, but its own facts.
    assert!(
        dom.contains("<td>seed</td><td>1</td><td>2</td>") && !dom.contains("<td>build</td>"),
        "what differs"
    );
    let print = scratch.path("two.pdf");
    let printing = Browser::open(&scratch, &url, 1600, &[&format!("--print-to-pdf={print}")]);
    printing.map(Browser::dom);
    assert!(Path::new(&print).metadata().is_ok_and(|file| file.len() > 10_000), "the page prints");
}
