//! Which stages of a run are done, and whether they have to be done again.

use std::collections::{BTreeMap, HashMap};
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

use plenocal::io::{self, Manifest, OutputFolder, StageRecord};
use plenocal::report::Section;
use plenocal::{Error, Result};
use rayon::prelude::*;
use serde_json::{Value, json};

use super::tell;

/// What a stage has for the report.
pub const SECTION: &str = "section.json";

/// Keeps account of the stages.
pub struct Ledger {
    pub out: PathBuf,
    pub manifest: Manifest,
    pub force: bool,
    pub quiet: bool,
    hashes: HashMap<PathBuf, String>,
    /// Stages of this run, in order; whether they were done.
    pub stages: Vec<(String, bool)>,
    /// What could not be done, in words.
    pub missing: Vec<String>,
}

impl Ledger {
    /// Of a run into a folder, in which an earlier one may have done stages.
    pub fn open(out: &Path, project: &Path, force: bool, quiet: bool) -> Self {
        let mut manifest = Manifest::new(project);
        manifest.stages = Manifest::read(out).map(|m| m.stages).unwrap_or_default();
        let (hashes, stages, missing) = (HashMap::new(), Vec::new(), Vec::new());
        Self { out: out.to_owned(), manifest, force, quiet, hashes, stages, missing }
    }

    fn hashes(&mut self, inputs: &[PathBuf]) -> Vec<String> {
        let unknown: Vec<&PathBuf> =
            inputs.iter().filter(|path| !self.hashes.contains_key(*path)).collect();
        // An image that cannot be read is told when its turn comes.
        let known: Vec<(PathBuf, String)> = unknown
            .par_iter()
            .map(|path| ((*path).clone(), io::hash_file(path).unwrap_or_default()))
            .collect();
        self.hashes.extend(known);
        inputs.iter().map(|path| self.hashes[path].clone()).collect()
    }

    /// Does a stage unless it is done: `work` stages files and gives what the report shows.
    pub fn stage(
        &mut self,
        name: &str,
        inputs: &[PathBuf],
        options: Value,
        work: impl FnOnce(&mut OutputFolder) -> Result<Section>,
    ) -> Result<()> {
        let begun = Instant::now();
        let hashes = self.hashes(inputs);
        let names: Vec<_> = inputs.iter().map(|path| path.file_name()).collect();
        let names: Vec<String> =
            names.iter().map(|n| n.unwrap_or_default().to_string_lossy().into_owned()).collect();
        let key = json!([name, env!("CARGO_PKG_VERSION"), names, hashes, options]).to_string();
        let key = io::hash_text(&key);
        let folder = self.out.join(name);
        for (path, hash) in inputs.iter().zip(&hashes) {
            // What other stages have written is noted with them.
            if !path.starts_with(&self.out) {
                self.manifest.inputs.insert(path.display().to_string(), hash.clone());
            }
        }
        let before = self.manifest.stage(name).cloned();
        if let Some(record) = &before
            && !self.force
            && record.key == key
            && record.is_intact(&folder)
        {
            self.say(&format!("{name}: unchanged"));
            self.stages.push((name.to_owned(), false));
            return Ok(());
        }
        let mut output = OutputFolder::new(&folder)?;
        let section = work(&mut output)?;
        let section = serde_json::to_value(&section)
            .map_err(|e| Error::Invalid(format!("the section of {name} cannot be written: {e}")))?;
        output.stage_json(SECTION, &section)?;
        let mut files = BTreeMap::new();
        for path in output.commit()? {
            let file = path.strip_prefix(&folder).unwrap_or(&path).display().to_string();
            files.insert(file, io::hash_file(&path)?);
        }
        // Of an earlier run, such as pictures of frames that are no more.
        let stale = before.iter().flat_map(|record| record.files.keys());
        for file in stale.filter(|file| !files.contains_key(*file)) {
            let _ = fs::remove_file(folder.join(file));
        }
        let time_s = begun.elapsed().as_secs_f64();
        self.manifest.note(StageRecord { name: name.to_owned(), key, options, time_s, files });
        self.manifest.write(&self.out)?;
        self.say(&format!("{name}: {time_s:.1} s"));
        self.stages.push((name.to_owned(), true));
        Ok(())
    }

    /// Notes what is wrong with a part without which the rest is still of use.
    pub fn tolerate(&mut self, what: &str, result: Result<()>) {
        if let Err(error) = result {
            let text = format!("{what}: {error}");
            tell(&format!("warning: {text}"));
            self.missing.push(text);
        }
    }

    pub fn has(&self, stage: &str) -> bool {
        self.stages.iter().any(|(name, _)| name == stage)
    }

    fn say(&self, line: &str) {
        if !self.quiet {
            tell(line);
        }
    }
}
