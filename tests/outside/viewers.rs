//! Programs that show what plenocal writes: shells, the formatter of manual pages, a browser.

use std::fs;
use std::process::{Command, Output};

use plenocal::assessment::assess;
use plenocal::report::{Report, calibration_figures, calibration_section};
use tempfile::TempDir;

use crate::support::{board, datasheet_start, options, plenocal, run, shipped_observations};

pub fn shells_accept_their_completions() {
    let folder = TempDir::new().unwrap();
    for shell in ["bash", "zsh", "fish"] {
        let script = folder.path().join(shell);
        fs::write(&script, plenocal().args(["completions", shell]).output().unwrap().stdout)
            .unwrap();
        let Output { status, stderr, .. } =
            Command::new(shell).arg("-n").arg(&script).output().expect(shell);
        assert!(status.success(), "{shell}: {}", String::from_utf8_lossy(&stderr));
    }
}

pub fn groff_formats_the_manual_pages_without_a_warning() {
    let folder = TempDir::new().unwrap();
    plenocal().args(["man", "--out"]).arg(folder.path()).assert().success();
    for page in fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().path()) {
        let mut groff = Command::new("groff");
        groff.args(["-man", "-Tutf8", "-ww"]).arg(&page);
        let Output { status, stderr, .. } = groff.output().expect("groff");
        assert!(status.success() && stderr.is_empty(), "{}", String::from_utf8_lossy(&stderr));
    }
}

/// Collects all failures from the start, and the state of the figures at the end.
const WATCH: &str = "<script>var failures = [];
addEventListener('error', e => failures.push(e.message || e.target.tagName), true);</script>";
const MEASURE: &str = "<script>addEventListener('load', () => {
  const page = document.documentElement;
  document.querySelectorAll('details').forEach(d => { d.open = true; });
  const sizes = [...document.querySelectorAll('figure svg')].map(svg => {
    const box = svg.getBoundingClientRect();
    return Math.floor(box.width) + 'x' + Math.floor(box.height);
  });
  page.dataset.sizes = sizes.join(' ');
  page.dataset.beyond = page.scrollWidth - page.clientWidth;
  page.dataset.failures = failures.join('; ');
});</script>";

/// The value that the page has left in an attribute of its root.
fn left_behind<'a>(dom: &'a str, name: &str) -> &'a str {
    let start = format!("data-{name}=\"");
    let rest =
        dom.split_once(&start).unwrap_or_else(|| panic!("the page did not run:\n{dom:.500}")).1;
    rest.split_once('"').expect("an attribute ends").0
}

pub fn a_browser_shows_all_figures() {
    let calibration = run(&datasheet_start(), &shipped_observations(), &options());
    let assessment = assess(&calibration, &board()).unwrap();
    let figures = calibration_figures(&calibration, &assessment, &board()).unwrap();
    let count = figures.len();
    let section = calibration_section("Calibration", &calibration, &assessment, figures);
    let (title, subtitle) = ("Calibration".into(), "The shipped feature set".into());
    let html = Report { title, subtitle, sections: vec![section] }.to_html();
    let folder = TempDir::new().unwrap();
    let page = folder.path().join("report.html");
    let html = html.replacen("<head>", &format!("<head>{WATCH}"), 1);
    let html = html.replacen("</body>", &format!("{MEASURE}</body>"), 1);
    fs::write(&page, html).unwrap();
    // A wide screen, and the narrowest window that the browser opens.
    for width in [1400, 500] {
        let output = Command::new("chromium")
            .args(["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic"])
            .args(["--no-first-run", "--disable-background-networking", "--disable-sync"])
            .args(["--disable-component-update", "--enable-logging=stderr", "--dump-dom"])
            .arg(format!("--user-data-dir={}", folder.path().join("profile").display()))
            .arg(format!("--window-size={width},900"))
            .arg(format!("file://{}", page.display()))
            .output()
            .unwrap();
        let dom = String::from_utf8_lossy(&output.stdout);
        let log = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{log}");
        assert!(!log.contains("CONSOLE"), "{log}");
        assert_eq!(left_behind(&dom, "failures"), "");
        assert_eq!(left_behind(&dom, "beyond"), "0", "wider than the page at {width} px");
        let sizes: Vec<(u32, u32)> = left_behind(&dom, "sizes")
            .split_whitespace()
            .map(|size| size.split_once('x').expect("width and height"))
            .map(|(width, height)| (width.parse().unwrap(), height.parse().unwrap()))
            .collect();
        assert_eq!(sizes.len(), count);
        assert!(sizes.iter().all(|s| s.0 > 100 && s.1 > 50 && s.0 <= width), "{sizes:?}");
    }
}
