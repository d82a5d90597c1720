//! Which stages of a run are done, and whether they have to be done again.

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};
use std::time::Instant;
use std::{env, fs};

use plenocal::io::{self, FolderLock, Manifest, OutputFolder, StageRecord};
use plenocal::report::Section;
use plenocal::{Error, Result};
use rayon::prelude::*;
use serde::Serialize;
use serde_json::json;

use super::talk::{say, warn};

/// The file with a stage's section of the report.
pub const SECTION: &str = "section.json";

/// A file that a stage reads. Its content matters, its folder does not.
#[derive(Debug, Clone, Serialize)]
pub struct InputFile {
    #[serde(skip)]
    pub path: PathBuf,
    name: String,
    sha256: String,
}

/// Keeps track of the stages.
pub struct Ledger {
    pub out: PathBuf,
    pub manifest: Manifest,
    pub force: bool,
    pub quiet: bool,
    hashes: HashMap<PathBuf, String>,
    /// Stages of this run, in order; whether they were done.
    pub stages: Vec<(String, bool)>,
    /// What could not be done, and why.
    pub missing: Vec<String>,
    /// Warnings, each with its stage.
    pub warnings: Vec<(String, String)>,
    /// Two runs at once would mix their stages.
    _held: FolderLock,
}

impl Ledger {
    /// Starts a run into a folder, in which an earlier run may have done some stages.
    pub fn open(out: &Path, project: &Path, force: bool, quiet: bool) -> Result<Self> {
        let held = FolderLock::hold(out)?;
        // A different program may compute different results from the same input. Its version alone
        // does not identify it: it may have been built from changed sources.
        let program = env::current_exe()
            .map_err(|source| Error::Read { path: "the running program".into(), source })?;
        let mut manifest = Manifest::new(project, io::hash_file(&program)?);
        manifest.stages = Manifest::read(out).map(|m| m.stages).unwrap_or_default();
        Ok(Self {
            out: out.to_owned(),
            manifest,
            force,
            quiet,
            hashes: HashMap::new(),
            stages: Vec::new(),
            missing: Vec::new(),
            warnings: Vec::new(),
            _held: held,
        })
    }

    /// Files as the input of a stage.
    pub fn files<P: AsRef<Path>>(&mut self, paths: impl IntoIterator<Item = P>) -> Vec<InputFile> {
        let paths: Vec<PathBuf> = paths.into_iter().map(|p| p.as_ref().to_owned()).collect();
        let unknown: Vec<&PathBuf> =
            paths.iter().filter(|path| !self.hashes.contains_key(*path)).collect();
        // An image that cannot be read is reported when its turn comes.
        let known: Vec<(PathBuf, String)> = unknown
            .par_iter()
            .map(|path| ((*path).clone(), io::hash_file(path).unwrap_or_default()))
            .collect();
        self.hashes.extend(known);
        paths.into_iter().map(|path| self.known(path)).collect()
    }

    /// A file as the input of a stage.
    pub fn file(&mut self, path: impl AsRef<Path>) -> InputFile {
        self.files([path.as_ref()]).remove(0)
    }

    fn known(&mut self, path: PathBuf) -> InputFile {
        let sha256 = self.hashes[&path].clone();
        // Files that other stages have written are recorded with them.
        if !path.starts_with(&self.out) {
            self.manifest.inputs.insert(path.display().to_string(), sha256.clone());
        }
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        InputFile { path, name, sha256 }
    }

    /// Does a stage unless it is already done. `work` stages files and returns the section of the
    /// report.
    ///
    /// The stage depends on its input alone: what it computes with, and what decides whether it is
    /// repeated, are one value.
    pub fn stage<I: Serialize>(
        &mut self,
        name: &str,
        input: &I,
        work: impl FnOnce(&I, &mut OutputFolder) -> Result<Section>,
    ) -> Result<()> {
        let begun = Instant::now();
        let json = |value: serde_json::Result<serde_json::Value>| {
            value.map_err(|e| Error::invalid(format!("stage {name} cannot be recorded: {e}")))
        };
        let input_json = json(serde_json::to_value(input))?;
        let key =
            io::hash_text(&json!([name, self.manifest.program_sha256, input_json]).to_string());
        let folder = self.out.join(name);
        let before = self.manifest.stage(name).cloned();
        if let Some(record) = &before
            && !self.force
            && record.key == key
            && record.is_intact(&folder)
        {
            self.warn(name, &said_before(&folder));
            self.say(&format!("{name}: unchanged"));
            self.stages.push((name.to_owned(), false));
            return Ok(());
        }
        let mut output = OutputFolder::new(&folder)?;
        let section = work(input, &mut output)?;
        self.warn(name, &section.warnings);
        output.stage_json(SECTION, &json(serde_json::to_value(&section))?)?;
        let mut files = BTreeMap::new();
        for path in output.commit()? {
            let file = path.strip_prefix(&folder).unwrap_or(&path).display().to_string();
            files.insert(file, io::hash_file(&path)?);
        }
        // From an earlier run, such as pictures of frames that no longer exist. Behind a link they are not ours.
        let before = before.filter(|_| !folder.is_symlink());
        let stale = before.iter().flat_map(|record| record.files.keys());
        for file in stale.filter(|file| !files.contains_key(*file)) {
            let _ = fs::remove_file(folder.join(file));
        }
        let time_s = begun.elapsed().as_secs_f64();
        let record = StageRecord { name: name.to_owned(), key, input: input_json, time_s, files };
        self.manifest.note(record);
        self.manifest.write(&self.out)?;
        self.say(&format!("{name}: {time_s:.1} s"));
        self.stages.push((name.to_owned(), true));
        Ok(())
    }

    /// Says what a stage warns of, and remembers it for the verdict.
    pub fn warn(&mut self, stage: &str, warnings: &[String]) {
        warn(warnings);
        self.warnings.extend(warnings.iter().map(|text| (stage.to_owned(), text.clone())));
    }

    /// Records the failure of a part that the rest can do without.
    pub fn tolerate(&mut self, what: &str, result: Result<()>) {
        if let Err(error) = result {
            let text = format!("{what}: {error}");
            say(&format!("warning: {text}"));
            self.warnings.push((what.to_owned(), error.to_string()));
            self.missing.push(text);
        }
    }

    pub fn has(&self, stage: &str) -> bool {
        self.stages.iter().any(|(name, _)| name == stage)
    }

    fn say(&self, line: &str) {
        if !self.quiet {
            say(line);
        }
    }
}

/// The warnings of a stage that an earlier run has done.
fn said_before(folder: &Path) -> Vec<String> {
    let text = fs::read(folder.join(SECTION)).unwrap_or_default();
    serde_json::from_slice::<Section>(&text).map(|section| section.warnings).unwrap_or_default()
}
