//! Makes the tables of measured figures in the documents anew: `make evidence`.
//!
//! Each part rewrites its own blocks, which stand between `<!-- evidence: NAME -->` and `<!-- end -->` in the page of docs
//! that the name begins with. A part that fails leaves its blocks unchanged, and the exit status tells.
//!
//!     cargo run --release --example evidence -- [--list] [--quick] [PART…]
//!
//! Without a PART, all parts run, for hours. `results` stands for all parts of that page. `--quick` takes few rows, rays
//! and boards and prints the blocks, to try a part; it writes nothing.

use std::fmt::Write;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::process::ExitCode;
use std::time::Instant;

use conditions::Conditions;
use plenocal::{Error, Result};
use sets::Extent;

mod aperture;
mod blocks;
mod cameras;
mod commands;
mod conditions;
mod corners;
mod exposure;
mod lenses;
mod paper;
mod points;
mod programs;
mod published;
mod sets;
mod shoot;
mod text;
mod whites;

/// Part of the evidence: tables that are made together.
struct Part {
    /// Name; it begins with the page.
    name: &'static str,
    /// Time that it takes on two cores.
    takes: &'static str,
    /// Names of its blocks, after its own name; empty if it has one block, of its own name.
    blocks: &'static [&'static str],
    /// Variable that has to be set.
    needs: Option<&'static str>,
    /// Makes the texts of the blocks.
    make: fn(&Extent) -> Result<Vec<String>>,
}

/// Variable with the folder of the published observations.
const R12A: &str = "PLENOCAL_R12A";

macro_rules! part {
    ($name:literal, $takes:literal, $make:path $(, blocks $blocks:expr)? $(, needs $needs:expr)?) => {{
        #[allow(unused_mut, reason = "not all parts have options")]
        let mut part = Part { name: $name, takes: $takes, blocks: &[], needs: None, make: $make };
        $(part.blocks = &$blocks;)?
        $(part.needs = Some($needs);)?
        part
    }};
}

fn parts() -> Vec<Part> {
    vec![
        part!(
            "results/paper",
            "6 min",
            paper::tables,
            blocks["parameters", "others", "internal", "displacement", "reprojection"]
        ),
        part!("results/cameras", "15 min", cameras::tables, blocks["errors", "models"]),
        part!(
            "results/published",
            "1 min",
            published::tables,
            blocks["minimum", "parameters", "priors", "variants"],
            needs R12A
        ),
        part!("accuracy/corners", "6 min", corners::errors),
        part!("accuracy/corner-bias", "5 min", corners::bias),
        part!("accuracy/white-images", "3 min", whites::discs),
        part!("accuracy/exposure", "2 min", exposure::estimators),
        part!("accuracy/point-spread", "20 min", whites::point_spread),
        part!("accuracy/linear-light", "30 s", whites::linear_light),
        part!("accuracy/tilt-gradient", "3 min", whites::tilt_gradient),
        part!("accuracy/tilt-gradient-with-boards", "2 min", aperture::tilt_gradient),
        part!("accuracy/aperture-ratio", "3 min", aperture::by_detection),
        part!("accuracy/cameras", "1 h", aperture::cameras),
        part!("accuracy/openings", "36 min", aperture::openings),
        part!("accuracy/lenses", "70 min", lenses::errors),
        part!("accuracy/decentred-lenses", "4 min", lenses::decentred),
        part!("accuracy/tilted-lenses", "3 min", lenses::tilted),
        part!("accuracy/board", "5 min", programs::board),
        part!("accuracy/standard-deviations", "5 min", programs::standard_deviations),
        part!("performance/commands", "4 min", commands::times),
        part!("performance/ceres", "2 min", programs::ceres, needs R12A),
        part!("performance/growth", "5 min", programs::growth),
        part!("use/points", "6 min", points::errors),
    ]
}

impl Part {
    /// Returns the full names of its blocks.
    fn blocks(&self) -> Vec<String> {
        if self.blocks.is_empty() {
            return vec![self.name.to_owned()];
        }
        self.blocks.iter().map(|block| format!("{}/{block}", self.name)).collect()
    }

    fn is_wanted(&self, word: &str) -> bool {
        let page = self.name.strip_prefix(word);
        page.is_some_and(|rest| rest.is_empty() || rest.starts_with('/'))
    }

    fn can_run(&self) -> bool {
        self.needs.is_none_or(|variable| std::env::var_os(variable).is_some())
    }

    /// Makes the blocks, and writes them into their page, or prints them.
    fn run(&self, extent: &Extent, conditions: &Conditions) -> Result<()> {
        let begun = Instant::now();
        let made = catch_unwind(AssertUnwindSafe(|| (self.make)(extent)));
        let texts = made.map_err(|_| Error::invalid("it panicked"))??;
        let names = self.blocks();
        assert_eq!(texts.len(), names.len(), "a part makes all of its blocks");
        let made = conditions.text(self.name, begun.elapsed());
        let last = names.len() - 1;
        for (i, (name, text)) in names.iter().zip(texts).enumerate() {
            let mut text = format!("{}\n", text.trim_end());
            // The blocks of a part follow each other on the page.
            if i == last {
                let _ = writeln!(text, "\n{made}");
            }
            if extent.quick {
                println!("{name}:\n\n{text}");
            } else {
                blocks::replace(name, &text)?;
            }
        }
        Ok(())
    }
}

fn main() -> ExitCode {
    let (options, words): (Vec<String>, Vec<String>) =
        std::env::args().skip(1).partition(|argument| argument.starts_with("--"));
    let has = |option: &str| options.iter().any(|other| other == option);
    let parts = parts();
    let unknown = words.iter().find(|word| !parts.iter().any(|part| part.is_wanted(word)));
    let unknown = options.iter().find(|o| !["--list", "--quick"].contains(&o.as_str())).or(unknown);
    if let Some(word) = unknown {
        eprintln!("there is no part or option {word}");
    }
    if unknown.is_some() || has("--list") {
        for part in &parts {
            println!("{:36} {}", part.name, part.takes);
        }
        return if unknown.is_some() { ExitCode::FAILURE } else { ExitCode::SUCCESS };
    }
    let wanted: Vec<&Part> = parts
        .iter()
        .filter(|part| words.is_empty() || words.iter().any(|word| part.is_wanted(word)))
        .collect();
    let extent = Extent { quick: has("--quick") };
    // A block that is missing is an error before the work, not after it.
    let mut blocks = wanted.iter().flat_map(|part| part.blocks());
    if let Some(error) = blocks.find_map(|block| blocks::find(&block).err()) {
        eprintln!("{error}");
        return ExitCode::FAILURE;
    }
    run(&wanted, &extent)
}

/// Runs the parts, and says at the end which were skipped or failed.
fn run(parts: &[&Part], extent: &Extent) -> ExitCode {
    let conditions = Conditions::now();
    let (mut skipped, mut failed) = (Vec::new(), Vec::new());
    for part in parts {
        if !part.can_run() {
            skipped.push(part);
            continue;
        }
        eprintln!("{} (about {})", part.name, part.takes);
        if let Err(error) = part.run(extent, &conditions) {
            eprintln!("{} failed: {error}", part.name);
            failed.push(part.name);
        }
    }
    for part in skipped {
        eprintln!("{} was skipped: {} is not set", part.name, part.needs.unwrap_or_default());
    }
    if failed.is_empty() {
        return ExitCode::SUCCESS;
    }
    eprintln!("failed, with their blocks unchanged: {}", failed.join(", "));
    ExitCode::FAILURE
}
