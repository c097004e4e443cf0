//! Chromium as a person uses it: clicks, taps, keys and pictures, over its debugging pipe.

use std::io::{BufRead as _, BufReader, Write as _};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use crate::{Scratch, skip};

/// Time limit of [`Browser::wait_for`], which separates "hangs" from "works".
const HANGS: Duration = Duration::from_mins(1);
/// Interval between questions of [`Browser::wait_for`].
const LOOK: Duration = Duration::from_millis(50);

/// A page in headless Chromium, closed when dropped.
#[derive(Debug)]
pub struct Browser {
    process: Child,
    commands: ChildStdin,
    answers: BufReader<ChildStdout>,
    session: String,
    last_id: u64,
    requests: Vec<String>,
    complaints: Vec<String>,
    _profile: Scratch,
}

impl Browser {
    /// Opens a page in a window of a size in pixels; `None` if Chromium is not installed. `STGDAT_CHROMIUM` names
    /// another program. Each test of a process needs its own `name`.
    ///
    /// # Panics
    /// If Chromium does not answer.
    pub fn open(name: &str, url: &str, [width, height]: [u32; 2]) -> Option<Self> {
        let chromium = std::env::var("STGDAT_CHROMIUM").unwrap_or_else(|_| "chromium".into());
        if let Err(error) = Command::new(&chromium).arg("--version").output() {
            skip(format_args!("{chromium}: {error} (STGDAT_CHROMIUM names another program)"));
            return None;
        }
        let profile = Scratch::new(&format!("browser-{name}"));
        let mut command = Command::new("sh");
        // Chromium reads commands from descriptor 3 and answers on 4.
        command.args(["-c", "exec \"$@\" 3<&0 4>&1 </dev/null >/dev/null 2>&1", "sh", &chromium]);
        command.args(["--headless=new", "--no-sandbox", "--disable-gpu", "--remote-debugging-pipe"]);
        command.args(["--disable-background-networking", "--no-first-run", "--disable-component-update"]);
        command.arg("--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1");
        command.arg(format!("--user-data-dir={}", profile.path("profile")));
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::null());
        let mut process = command.spawn().expect("sh is installed");
        let commands = process.stdin.take().expect("it is piped");
        let answers = BufReader::new(process.stdout.take().expect("it is piped"));
        let mut browser = Self {
            process,
            commands,
            answers,
            session: String::new(),
            last_id: 0,
            requests: Vec::new(),
            complaints: Vec::new(),
            _profile: profile,
        };
        let target = browser.call("Target.createTarget", json!({ "url": "about:blank" }));
        let attach = json!({ "targetId": target["targetId"], "flatten": true });
        let session = browser.call("Target.attachToTarget", attach);
        session["sessionId"].as_str().unwrap().clone_into(&mut browser.session);
        for domain in ["Page", "Runtime", "Network", "Log"] {
            browser.call(&format!("{domain}.enable"), json!({}));
        }
        browser.resize([width, height]);
        browser.call("Page.navigate", json!({ "url": url }));
        browser.wait_for("document.readyState === 'complete'");
        Some(browser)
    }

    /// Sends a command of the [protocol](https://chromedevtools.github.io/devtools-protocol/) and returns its
    /// result.
    ///
    /// # Panics
    /// If the command fails.
    pub fn call(&mut self, method: &str, parameters: Value) -> Value {
        self.last_id += 1;
        let mut message = json!({ "id": self.last_id, "method": method });
        message["params"] = parameters;
        if !self.session.is_empty() {
            message["sessionId"] = self.session.as_str().into();
        }
        let mut bytes = message.to_string().into_bytes();
        bytes.push(0);
        self.commands.write_all(&bytes).expect("Chromium is running");
        loop {
            let mut bytes = Vec::new();
            self.answers.read_until(0, &mut bytes).expect("Chromium is running");
            assert_eq!(bytes.pop(), Some(0), "Chromium has ended");
            let answer: Value = serde_json::from_slice(&bytes).unwrap();
            if answer["id"] == self.last_id {
                assert!(answer["error"].is_null(), "{method}: {}", answer["error"]);
                return answer["result"].clone();
            }
            self.take_event(&answer);
        }
    }

    fn take_event(&mut self, event: &Value) {
        let parameters = &event["params"];
        match event["method"].as_str().unwrap_or_default() {
            "Network.requestWillBeSent" => {
                self.requests.push(parameters["request"]["url"].as_str().unwrap().to_owned());
            }
            "Log.entryAdded" => self.complaints.push(parameters["entry"].to_string()),
            "Runtime.exceptionThrown" => self.complaints.push(parameters["exceptionDetails"].to_string()),
            _ => {}
        }
    }

    /// Sets the size of the window. One of at most 500 pixels has a touch screen.
    pub fn resize(&mut self, [width, height]: [u32; 2]) {
        let is_phone = width <= 500;
        let size = json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": is_phone });
        self.call("Emulation.setDeviceMetricsOverride", size);
        self.call("Emulation.setTouchEmulationEnabled", json!({ "enabled": is_phone }));
    }

    /// The value of an expression of the page, after promises.
    ///
    /// # Panics
    /// If the expression throws.
    pub fn value(&mut self, expression: &str) -> Value {
        let options = json!({ "expression": expression, "awaitPromise": true, "returnByValue": true });
        let result = self.call("Runtime.evaluate", options);
        assert!(result["exceptionDetails"].is_null(), "{expression}: {}", result["exceptionDetails"]);
        result["result"]["value"].clone()
    }

    /// The text of the first element that a selector matches.
    pub fn text(&mut self, selector: &str) -> String {
        let text = self.value(&format!("document.querySelector({selector:?}).innerText"));
        text.as_str().unwrap_or_default().to_owned()
    }

    /// Waits until an expression of the page is true.
    ///
    /// # Panics
    /// If the expression stays false.
    pub fn wait_for(&mut self, expression: &str) {
        let begun = Instant::now();
        while self.value(&format!("Boolean({expression})")) != true {
            assert!(begun.elapsed() < HANGS, "never true: {expression}");
            std::thread::sleep(LOOK);
        }
    }

    /// The middle of the first element that a selector matches, scrolled into view.
    fn middle(&mut self, selector: &str) -> [f64; 2] {
        let place = self.value(&format!(
            "(() => {{ const e = document.querySelector({selector:?}); e.scrollIntoView({{ block: 'nearest' }}); \
             const b = e.getBoundingClientRect(); return [b.x + b.width / 2, b.y + b.height / 2]; }})()"
        ));
        [0, 1].map(|axis| place[axis].as_f64().unwrap())
    }

    /// Clicks on the first element that a selector matches.
    pub fn click(&mut self, selector: &str) {
        let place = self.middle(selector);
        self.click_at(place);
    }

    /// Clicks on a place of the window.
    pub fn click_at(&mut self, [x, y]: [f64; 2]) {
        for kind in ["mousePressed", "mouseReleased"] {
            let event = json!({ "type": kind, "x": x, "y": y, "button": "left", "clickCount": 1 });
            self.call("Input.dispatchMouseEvent", event);
        }
    }

    /// Taps on a place of the window with a finger.
    pub fn tap_at(&mut self, [x, y]: [f64; 2]) {
        let points = json!([{ "x": x, "y": y }]);
        self.call("Input.dispatchTouchEvent", json!({ "type": "touchStart", "touchPoints": points }));
        self.call("Input.dispatchTouchEvent", json!({ "type": "touchEnd", "touchPoints": [] }));
    }

    /// Presses a key by its name, such as `ArrowLeft`.
    pub fn press(&mut self, key: &str) {
        for kind in ["keyDown", "keyUp"] {
            let code = match key {
                "ArrowLeft" => 37,
                "ArrowRight" => 39,
                "Home" => 36,
                "End" => 35,
                _ => 0,
            };
            let event = json!({ "type": kind, "key": key, "code": key, "windowsVirtualKeyCode": code });
            self.call("Input.dispatchKeyEvent", event);
        }
    }

    /// Types a text into the element that has the focus.
    pub fn insert(&mut self, text: &str) {
        self.call("Input.insertText", json!({ "text": text }));
    }

    /// The URLs of all requests so far.
    pub fn requests(&self) -> &[String] {
        &self.requests
    }

    /// The errors and warnings of the console so far.
    pub fn complaints(&self) -> &[String] {
        &self.complaints
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        self.session.clear();
        // The answer may not come: Chromium ends.
        let _ = self.commands.write_all(b"{\"id\":0,\"method\":\"Browser.close\"}\0");
        let mut rest = Vec::new();
        let _ = std::io::Read::read_to_end(&mut self.answers, &mut rest);
        let _ = self.process.wait();
    }
}
