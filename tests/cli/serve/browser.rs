//! The page in a real browser: it draws, a click tells the value, nothing is complained of.
//!
//! The browser is driven through its debugging pipe (file descriptors 3 and 4, JSON between zero
//! bytes), which needs no further program.

use super::client::Server;
use crate::cli::words;
use crate::support::data::shared;
use crate::support::program::brickmarch;
use crate::support::report::skipped;
use crate::support::scratch::Scratch;
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Write};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::time::{Duration, Instant};

const WINDOW: [u32; 2] = [1100, 740];

/// A headless browser with one page.
struct Browser {
    child: Child,
    to: ChildStdin,
    from: BufReader<ChildStdout>,
    calls: u64,
    session: Option<String>,
    /// Errors that the page made.
    complaints: Vec<String>,
}

impl Browser {
    /// The browser, where there is one: `BRICKMARCH_CHROMIUM`, or by its usual names.
    fn start(scratch: &Scratch) -> Option<Browser> {
        let named = std::env::var("BRICKMARCH_CHROMIUM").ok();
        let usual = ["chromium", "chromium-browser", "google-chrome"].map(String::from);
        let program = named.into_iter().chain(usual).find(|name| {
            let version = Command::new(name).arg("--version").output();
            version.is_ok_and(|v| v.status.success())
        })?;
        let script = "exec \"$@\" 3<&0 4>&1 0</dev/null 1>/dev/null";
        let profile = format!("--user-data-dir={}", scratch.path("profile").display());
        let mut child = Command::new("bash")
            .args(["-c", script, "browser", &program])
            .args([
                "--headless",
                "--no-sandbox",
                "--disable-gpu",
                "--disable-dev-shm-usage",
            ])
            .args([
                "--remote-debugging-pipe",
                "--no-first-run",
                &profile,
                "about:blank",
            ])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("bash starts it");
        let mut browser = Browser {
            to: child.stdin.take().expect("piped"),
            from: BufReader::new(child.stdout.take().expect("piped")),
            child,
            calls: 0,
            session: None,
            complaints: Vec::new(),
        };
        let made = browser.call("Target.createTarget", json!({ "url": "about:blank" }));
        let attach = json!({ "targetId": made["targetId"], "flatten": true });
        let attached = browser.call("Target.attachToTarget", attach);
        browser.session = attached["sessionId"].as_str().map(String::from);
        for domain in ["Page", "Runtime", "Log"] {
            browser.call(&format!("{domain}.enable"), json!({}));
        }
        let [width, height] = WINDOW;
        let metrics =
            json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": false });
        browser.call("Emulation.setDeviceMetricsOverride", metrics);
        Some(browser)
    }

    fn call(&mut self, method: &str, params: Value) -> Value {
        self.calls += 1;
        let mut message = json!({ "id": self.calls, "method": method, "params": params });
        if let Some(session) = &self.session {
            message["sessionId"] = json!(session);
        }
        write!(self.to, "{message}\0").expect("the browser runs");
        loop {
            let mut text = Vec::new();
            self.from
                .read_until(0, &mut text)
                .expect("the browser runs");
            assert_eq!(text.pop(), Some(0), "the browser ended at {method}");
            let said: Value = serde_json::from_slice(&text).expect("JSON");
            if said["id"] == self.calls {
                assert!(said["error"].is_null(), "{method}: {said}");
                return said["result"].clone();
            }
            let kind = said["method"].as_str().unwrap_or("");
            let level = said["params"]["entry"]["level"].as_str();
            if kind == "Runtime.exceptionThrown"
                || kind == "Log.entryAdded" && level == Some("error")
            {
                self.complaints.push(said["params"].to_string());
            }
        }
    }

    /// The value of an expression in the page.
    fn evaluate(&mut self, expression: &str) -> Value {
        let params =
            json!({ "expression": expression, "awaitPromise": true, "returnByValue": true });
        let said = self.call("Runtime.evaluate", params);
        assert!(said["exceptionDetails"].is_null(), "{expression}: {said}");
        said["result"]["value"].clone()
    }

    /// Waits until an expression is true.
    fn wait(&mut self, expression: &str) {
        let begun = Instant::now();
        while self.evaluate(expression) != json!(true) {
            assert!(
                begun.elapsed() < Duration::from_secs(60),
                "never true: {expression}: {:?}",
                self.complaints
            );
            std::thread::sleep(Duration::from_millis(30));
        }
    }

    fn click(&mut self, x: f64, y: f64) {
        for kind in ["mousePressed", "mouseReleased"] {
            let event = json!({ "type": kind, "x": x, "y": y, "button": "left", "clickCount": 1 });
            self.call("Input.dispatchMouseEvent", event);
        }
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

const READY: &str = "document.body?.dataset.ready === '1'";

#[test]
fn the_page_shows_a_scan_and_a_click_tells_the_value() {
    let what = "the page in a browser";
    let Some(scan) = shared("volumes/ct_abdomen_crop128_i16.nrrd", what) else {
        return;
    };
    let scratch = Scratch::new("serve-browser");
    let Some(mut browser) = Browser::start(&scratch) else {
        skipped(&format!(
            "{what}: no Chromium: install it, or name it by BRICKMARCH_CHROMIUM"
        ));
        return;
    };
    let line = format!("import {} @ct.bvol --levels 1 -q", scan.display());
    brickmarch(words(&scratch, &line)).success();
    let server = Server::start(&scratch, "@ct.bvol --mem 64MiB");
    let url = format!("http://{}/#ct", server.address);
    browser.call("Page.navigate", json!({ "url": url }));
    browser.wait(READY);
    let notes = "[...document.querySelectorAll('.note')].map(n => n.textContent).join('')";
    assert_eq!(browser.evaluate(notes), json!(""));
    let drawn =
        "[...document.images].filter(i => i.naturalWidth > 50 && i.getClientRects().length).length";
    assert_eq!(
        browser.evaluate(drawn),
        json!(4),
        "three slices and a surface"
    );

    // A click at a place of the slice across z.
    let place = browser.evaluate(
        "(() => { const b = document.querySelector('#z img').getBoundingClientRect(); \
         return [b.left + b.width * (20.5 / 128), b.top + b.height * (70.5 / 128)]; })()",
    );
    let [x, y] = [0, 1].map(|i| place[i].as_f64().expect("a number"));
    browser.click(x, y);
    let index = "document.getElementById('at').textContent";
    browser.wait(&format!("{index}.startsWith('20, 70,')"));
    let at = browser
        .evaluate(index)
        .as_str()
        .expect("text")
        .replace(' ', "");
    let told = server
        .get(&format!("/api/volumes/ct/value?at={at}"))
        .ok()
        .json();
    let shown = browser.evaluate("+document.getElementById('value').textContent");
    assert_eq!(shown.as_f64(), told["value"].as_f64());

    // Another window and another colour map are another picture; another isovalue another surface.
    browser.wait(READY);
    let sum = |of: &str| {
        format!(
            "(() => {{ const i = document.querySelector('{of} img'), c = document.createElement('canvas'); \
             c.width = i.naturalWidth; c.height = i.naturalHeight; const p = c.getContext('2d'); \
             p.drawImage(i, 0, 0); \
             return p.getImageData(0, 0, c.width, c.height).data.reduce((a, b) => a + b, 0); }})()"
        )
    };
    let before = ["#z", "#surface"].map(|of| browser.evaluate(&sum(of)));
    for (id, value) in [
        ("centretext", "300"),
        ("widthtext", "100"),
        ("map", "inferno"),
        ("isotext", "250"),
    ] {
        browser.evaluate(&format!(
            "{{ const e = document.getElementById('{id}'); e.value = '{value}'; \
             e.dispatchEvent(new Event('change')); true }}"
        ));
    }
    browser.wait(READY);
    let after = ["#z", "#surface"].map(|of| browser.evaluate(&sum(of)));
    assert!(
        before[0] != after[0] && before[1] != after[1],
        "{before:?} {after:?}"
    );

    // An isovalue without a surface is said, and is no end.
    browser.evaluate(
        "{ const e = $('isotext'); e.value = '30000'; e.dispatchEvent(new Event('change')); true }",
    );
    browser.wait(READY);
    assert!(
        browser
            .evaluate(notes)
            .as_str()
            .is_some_and(|n| n.len() > 10)
    );
    let expected = |c: &String| c.contains("/preview?iso=30000");
    let complaints: Vec<_> = browser.complaints.iter().filter(|c| !expected(c)).collect();
    assert!(complaints.is_empty(), "{complaints:?}");

    let picture = browser.call("Page.captureScreenshot", json!({}));
    let encoded = picture["data"].as_str().expect("a picture");
    // An empty page of this size has a few kilobytes.
    assert!(encoded.len() > 60_000, "{} characters", encoded.len());
}
