//! Programs that show what plenocal writes: shells, the formatter of manual pages, a browser.

use std::fs;
use std::path::Path;
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

/// A browser without a screen that leaves its own files in a folder.
fn browser(profile: &Path) -> Command {
    let mut browser = Command::new("chromium");
    browser
        .args(["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic"])
        .args(["--no-first-run", "--disable-background-networking", "--disable-sync"])
        .args(["--disable-component-update", "--enable-logging=stderr"])
        .arg(format!("--user-data-dir={}", profile.display()));
    browser
}

/// The page after its scripts, in a window of this width; a message on the console is an error.
fn browsed(page: &Path, width: u32) -> String {
    let profile = TempDir::new().unwrap();
    let output = browser(profile.path())
        .args(["--dump-dom", "--virtual-time-budget=20000"])
        .arg(format!("--window-size={width},900"))
        .arg(format!("file://{}", page.display()))
        .output()
        .unwrap();
    let log = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{log}");
    assert!(!log.contains("CONSOLE"), "{log}");
    String::from_utf8(output.stdout).unwrap()
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
        let dom = browsed(&page, width);
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

/// Looks into a picture as a user does, and leaves what it saw.
const LOOK: &str = r#"<script>addEventListener('load', async () => {
  const page = document.documentElement;
  const wait = async ready => {
    for (let i = 0; i < 100 && !ready(); i++) await new Promise(done => setTimeout(done, 50));
    return ready();
  };
  const find = name => document.querySelector('.pictures ' + name);
  const press = (element, key) => element.dispatchEvent(new KeyboardEvent('keydown', { key, bubbles: true }));
  const zoomed = () => find('.status').textContent.match(/shown ([^,]*)/)[1];
  const opened = () => {
    const views = document.querySelectorAll('.cut-outs figure').length;
    return find('.micro-images').hidden ? 'none' : find('h4').textContent.match(/Corner \d+/)[0] + ':' + views;
  };
  const seen = [];
  await wait(() => find('#picture-corner')?.options.length > 1);
  const canvas = find('canvas');
  seen.push(zoomed());
  press(canvas, '+');
  seen.push(zoomed());
  find('button[aria-label="Show all"]').click();
  seen.push(zoomed());
  // The corner in the middle of its list is shown in the middle of the picture.
  const corner = find('#picture-corner');
  corner.selectedIndex = corner.options.length >> 1;
  const expected = 'Corner ' + corner.value + ':' + corner.selectedOptions[0].text.match(/(\d+) micro/)[1];
  corner.dispatchEvent(new Event('change'));
  find('.micro-images button').click();
  seen.push(opened() === 'none' ? 'shut' : opened());
  const box = canvas.getBoundingClientRect();
  const middle = { clientX: box.x + box.width / 2, clientY: box.y + box.height / 2 };
  canvas.dispatchEvent(new MouseEvent('click', middle));
  seen.push(opened() === expected ? 'clicked' : opened());
  seen.push(find('figcaption').textContent.match(/u [\d.]+ ± [\d.]+ \([+−][\d.]+\)/) ? 'values' : find('figcaption').textContent);
  press(find('.micro-images'), 'Escape');
  seen.push(opened() === 'none' ? 'shut' : opened());
  press(canvas, 'Enter');
  seen.push(opened() === expected ? 'entered' : opened());
  const scene = document.querySelector('svg[data-scene]');
  const before = scene.innerHTML;
  press(scene, 'ArrowLeft');
  seen.push(scene.innerHTML === before ? 'the scene stands' : 'the scene turns');
  press(scene, '0');
  seen.push(await wait(() => find('.status').textContent.includes('the image itself')) ? 'the image itself' : find('.status').textContent);
  document.querySelectorAll('details').forEach(d => { d.open = true; });
  page.dataset.beyond = page.scrollWidth - page.clientWidth;
  page.dataset.seen = seen.join('; ');
  page.dataset.failures = failures.join('; ');
});</script>"#;

pub fn a_browser_looks_into_the_pictures_of_a_run() {
    let folder = TempDir::new().unwrap();
    let [set, results] = ["a set", "results"].map(|name| folder.path().join(name));
    plenocal()
        .args(["simulate", "--set", "rays=24", "--set", "boards.calibration=6"])
        .args(["--set", "boards.evaluation=2", "--set", "translation.images=4", "--out"])
        .arg(&set)
        .assert()
        .success();
    let mut run = plenocal();
    run.arg("run").arg(set.join("project.toml")).arg("--out").arg(&results);
    run.args(["--folds", "0"]).assert().success();
    let html = fs::read_to_string(results.join("report.html")).unwrap();
    let html = html.replacen("<head>", &format!("<head>{WATCH}"), 1);
    let html = html.replacen("</body>", &format!("{LOOK}</body>"), 1);
    let page = results.join("watched.html");
    fs::write(&page, html).unwrap();
    for width in [1200, 800] {
        let dom = browsed(&page, width);
        let seen: Vec<&str> = left_behind(&dom, "seen").split("; ").collect();
        assert_ne!(seen[0], seen[1], "a key zooms");
        assert_eq!(seen[0], seen[2], "a button shows all");
        let rest = ["shut", "clicked", "values", "shut", "entered", "the scene turns"];
        assert_eq!(seen[3..], [&rest[..], &["the image itself"]].concat());
        assert_eq!(left_behind(&dom, "failures"), "");
        assert_eq!(left_behind(&dom, "beyond"), "0", "wider than the page at {width} px");
    }
    a_certificate_is_one_page(&results);
}

fn a_certificate_is_one_page(results: &Path) {
    let profile = TempDir::new().unwrap();
    let printed = results.join("certificate.pdf");
    let output = browser(profile.path())
        .arg(format!("--print-to-pdf={}", printed.display()))
        .arg(format!("file://{}", results.join("certificate.html").display()))
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let printed = fs::read(printed).unwrap();
    let printed = String::from_utf8_lossy(&printed);
    assert_eq!(printed.matches("/Type /Page\n").count(), 1, "pages");
}
