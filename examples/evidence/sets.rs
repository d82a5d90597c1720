//! Simulated sets: the rows of the tables.

use plenocal::Result;
use plenocal::simulation::Settings;

/// How much is measured.
pub struct Extent {
    /// True for a trial of a part, with few rows, rays and boards.
    pub quick: bool,
}

/// Simulated set.
pub struct Set {
    /// Name in the table.
    pub name: &'static str,
    /// Preset of `plenocal simulate`, or [`F25`].
    pub preset: &'static str,
    /// Replaced settings, as of `plenocal simulate --set`.
    pub replaced: &'static [&'static str],
}

/// Camera of 25.4 mm, which is not a preset.
pub const F25: &str = "f25";

/// Creates a set.
pub const fn set(
    name: &'static str,
    preset: &'static str,
    replaced: &'static [&'static str],
) -> Set {
    Set { name, preset, replaced }
}

impl Set {
    fn settings(&self, seed: u64, quick: &[&str]) -> Result<Settings> {
        let seed = format!("seed={seed}");
        let replaced =
            quick.iter().copied().chain([seed.as_str()]).chain(self.replaced.iter().copied());
        let replaced: Vec<String> = replaced.map(str::to_owned).collect();
        match self.preset {
            F25 => Settings::from_toml(include_str!("../../data/simulations/f25.toml"), &replaced),
            preset => Settings::preset(preset, &replaced),
        }
    }
}

/// Settings of a trial: enough boards for all parts.
const QUICK: [&str; 4] =
    ["rays=32", "boards.calibration=6", "boards.evaluation=2", "translation.images=2"];

impl Extent {
    /// Returns the settings of sets, each with its own seed, counted from the first one. A trial has the first and the last
    /// set only, but the settings of all are checked.
    pub fn settings<'a>(&self, sets: &'a [Set], seed: u64) -> Result<Vec<(&'a Set, Settings)>> {
        let quick: &[&str] = if self.quick { &QUICK } else { &[] };
        let numbered = (seed..).zip(sets);
        let mut all = numbered
            .map(|(seed, set)| Ok((set, set.settings(seed, quick)?)))
            .collect::<Result<Vec<_>>>()?;
        if self.quick && all.len() > 2 {
            all.drain(1..all.len() - 1);
        }
        Ok(all)
    }

    /// Returns a number, or a smaller one for a trial.
    pub fn or_few(&self, all: usize, few: usize) -> usize {
        if self.quick { few } else { all }
    }
}

/// Names the seeds of the rows of a table.
pub fn seeds(sets: &[Set], first: u64) -> String {
    format!("Seeds {first} to {}, row by row.", first + sets.len() as u64 - 1)
}

/// Shows what is being measured.
pub fn step(what: &str) {
    eprintln!("  {}", what.replace('`', ""));
}
