//! The verdict on a whole run: that on the calibration, with what other stages speak against it.

use plenocal::report::{Part, Section};
use serde_json::{Value, json};

use super::stages::{EVALUATION, IMAGES, PRECALIBRATION};

/// Stages whose warnings speak against a camera. Frames that were left out are told, but the others may be enough.
const HEARD: [&str; 3] = [IMAGES, PRECALIBRATION, EVALUATION];
const GOOD: &str = "good";
const CARE: &str = "usable with care";
const DO_NOT_USE: &str = "do not use";

/// What to do with the camera of a run, and why.
pub struct RunVerdict {
    verdict: &'static str,
    /// Verdict and text, the heaviest first.
    reasons: Vec<(&'static str, String)>,
    /// What would help most.
    next: Option<String>,
}

impl RunVerdict {
    /// From the verdict in calibration.json, its section of the report, and the warnings of all stages.
    pub fn of(calibration: &Value, section: &Section, warnings: &[(String, String)]) -> Self {
        let reason = |reason: &Value| {
            let worst = reason["verdict"].as_str() == Some(DO_NOT_USE);
            let text = reason["text"].as_str().unwrap_or_default().to_owned();
            (if worst { DO_NOT_USE } else { CARE }, text)
        };
        let own = calibration["verdict"]["reasons"].as_array().into_iter().flatten().map(reason);
        let heard = warnings.iter().filter(|(stage, _)| HEARD.contains(&stage.as_str()));
        let others = heard.map(|(stage, text)| (CARE, format!("{stage}: {text}")));
        let mut reasons: Vec<_> = own.chain(others).collect();
        // What other stages say stands before what merely asks for care in the calibration.
        reasons.sort_by_key(|(verdict, _)| *verdict != DO_NOT_USE);
        let verdict = reasons.first().map_or(GOOD, |(verdict, _)| verdict);
        let is_next = |part: &Part| match part {
            Part::Text(line) if line.starts_with("Next:") => Some(line.clone()),
            _ => None,
        };
        Self { verdict, reasons, next: section.parts.iter().find_map(is_next) }
    }

    /// As lines of text.
    pub fn lines(&self) -> Vec<String> {
        let first = if self.reasons.is_empty() {
            "Verdict: good. Nothing speaks against this calibration.".to_owned()
        } else {
            format!("Verdict: {}, because", self.verdict)
        };
        let numbered = self.reasons.iter().enumerate();
        let reasons =
            numbered.map(|(i, (_, text))| format!("{}. {}.", i + 1, text.trim_end_matches('.')));
        std::iter::once(first).chain(reasons).chain(self.next.clone()).collect()
    }

    /// As the first section of the report.
    pub fn section(&self) -> Section {
        let parts = self.lines().into_iter().map(Part::Text).collect();
        Section { title: "Verdict".to_owned(), parts, ..Section::default() }
    }

    pub fn document(&self) -> Value {
        let reason = |(verdict, text): &(&str, String)| json!({ "verdict": verdict, "text": text });
        json!({
            "verdict": self.verdict,
            "reasons": self.reasons.iter().map(reason).collect::<Vec<_>>(),
        })
    }
}
