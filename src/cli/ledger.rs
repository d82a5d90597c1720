//! Which stages of a run are done, and whether they have to be done again.

use std::collections::{BTreeMap, HashMap};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::time::{Instant, SystemTime};
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

/// What belongs to all stages together, and is written last. It may not stay beside other stages.
pub const REPORT: &str = "report.html";
pub const VERDICT: &str = "verdict.json";

/// The work of a stage: what it writes, and whether it has to be repeated.
pub struct Work {
    pub output: OutputFolder,
    /// Something could not be read that may be readable the next time.
    pub again: bool,
}

/// What tells that a file was changed or replaced: its size, and when it was changed.
type Look = (u64, Option<SystemTime>);

/// Keeps track of the stages.
pub struct Ledger {
    pub out: PathBuf,
    pub manifest: Manifest,
    pub force: bool,
    pub quiet: bool,
    hashes: HashMap<PathBuf, (String, Option<Look>)>,
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
        let known: Vec<_> = unknown
            .par_iter()
            .map(|path| {
                let seen = look(path);
                ((*path).clone(), (io::hash_file(path).unwrap_or_default(), seen))
            })
            .collect();
        self.hashes.extend(known);
        paths.into_iter().map(|path| self.known(path)).collect()
    }

    /// A file as the input of a stage.
    pub fn file(&mut self, path: impl AsRef<Path>) -> InputFile {
        self.files([path.as_ref()]).remove(0)
    }

    fn known(&mut self, path: PathBuf) -> InputFile {
        let sha256 = self.hashes[&path].0.clone();
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
        work: impl FnOnce(&I, &mut Work) -> Result<Section>,
    ) -> Result<()> {
        let begun = Instant::now();
        let input_json = json(name, serde_json::to_value(input))?;
        let key =
            io::hash_text(&json!([name, self.manifest.program_sha256, input_json]).to_string());
        let folder = self.own_folder(name)?;
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
        let mut working = Work { output: OutputFolder::new(&folder)?, again: false };
        let section = work(input, &mut working)?;
        let changed = self.changed();
        self.warn(name, &section.warnings);
        self.warn(name, &changed);
        let Work { mut output, again } = working;
        output.stage_json(SECTION, &json(name, serde_json::to_value(&section))?)?;
        self.retire_report()?;
        let mut files = BTreeMap::new();
        for path in output.commit()? {
            let file = path.strip_prefix(&folder).unwrap_or(&path).display().to_string();
            files.insert(file, io::hash_file(&path)?);
        }
        // From an earlier run, such as pictures of frames that no longer exist.
        let stale = before.iter().flat_map(|record| record.files.keys());
        for file in stale.filter(|file| !files.contains_key(*file)) {
            let _ = fs::remove_file(folder.join(file));
        }
        let time_s = begun.elapsed().as_secs_f64();
        // No input has an empty key: the next run does the stage again.
        let key = if again || !changed.is_empty() { String::new() } else { key };
        let record = StageRecord { name: name.to_owned(), key, input: input_json, time_s, files };
        self.manifest.note(record);
        self.manifest.write(&self.out)?;
        self.say(&format!("{name}: {time_s:.1} s"));
        self.stages.push((name.to_owned(), true));
        Ok(())
    }

    /// The folder of a stage; an error if it is a link, through which files elsewhere would be replaced.
    fn own_folder(&self, stage: &str) -> Result<PathBuf> {
        let folder = self.out.join(stage);
        if folder.is_symlink() {
            return Err(Error::invalid(
                "is a link, but the results of a run belong into its own folder: remove the link",
            )
            .in_file(&folder));
        }
        Ok(folder)
    }

    /// Files that were changed since they were hashed: what was computed may be of either content.
    fn changed(&self) -> Vec<String> {
        let read = self.hashes.iter().filter(|(path, _)| !path.starts_with(&self.out));
        let changed = read.filter(|(path, (_, seen))| look(path) != *seen);
        let mut texts: Vec<String> = changed
            .map(|(path, _)| format!("{} was changed while it was read: run again", path.display()))
            .collect();
        texts.sort();
        texts
    }

    /// Removes the report of an earlier run, which is not that of the stages to come.
    fn retire_report(&self) -> Result<()> {
        for path in [REPORT, VERDICT].map(|name| self.out.join(name)) {
            match fs::remove_file(&path) {
                Err(source) if source.kind() != ErrorKind::NotFound => {
                    return Err(Error::Write { path, source });
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// Writes the manifest of the whole run.
    pub fn finish(&self) -> Result<()> {
        self.retire_report()?;
        self.manifest.write(&self.out)
    }

    /// Says what a stage warns of, and remembers it for the verdict.
    pub fn warn(&mut self, stage: &str, warnings: &[String]) {
        warn(warnings);
        self.warnings.extend(warnings.iter().map(|text| (stage.to_owned(), text.clone())));
    }

    /// Records the failure of a part that the rest can do without. What cannot be written is not tolerated: the rest could
    /// not be written either.
    pub fn tolerate(&mut self, what: &str, result: Result<()>) -> Result<()> {
        if let Err(error) = result {
            if matches!(error, Error::Write { .. }) {
                return Err(error);
            }
            let text = format!("{what}: {error}");
            say(&format!("warning: {text}"));
            self.warnings.push((what.to_owned(), error.to_string()));
            self.missing.push(text);
        }
        Ok(())
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

fn look(path: &Path) -> Option<Look> {
    let metadata = fs::metadata(path).ok()?;
    Some((metadata.len(), metadata.modified().ok()))
}

fn json(stage: &str, value: serde_json::Result<serde_json::Value>) -> Result<serde_json::Value> {
    value.map_err(|e| Error::invalid(format!("stage {stage} cannot be recorded: {e}")))
}

/// The warnings of a stage that an earlier run has done.
fn said_before(folder: &Path) -> Vec<String> {
    let text = fs::read(folder.join(SECTION)).unwrap_or_default();
    serde_json::from_slice::<Section>(&text).map(|section| section.warnings).unwrap_or_default()
}
