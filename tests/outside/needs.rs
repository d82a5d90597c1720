//! What a test may need from outside the repository.

use std::env;
use std::path::{Path, PathBuf};

/// Data in a folder that a variable names, or programs in `PATH`.
#[derive(Clone, Copy)]
pub enum Need {
    Folder { variable: &'static str },
    Programs(&'static [&'static str]),
}

/// The real R12-A observations.
pub const R12A: Need = Need::Folder { variable: "PLENOCAL_R12A" };
/// Real white images and a maker's calibration.
pub const WHITES: Need = Need::Folder { variable: "PLENOCAL_WHITES" };
/// The programs of `cpp/examples`.
pub const EXAMPLES: Need = Need::Folder { variable: "PLENOCAL_EXAMPLES" };
pub const SHELLS: Need = Need::Programs(&["bash", "zsh", "fish"]);
pub const GROFF: Need = Need::Programs(&["groff"]);
pub const BROWSER: Need = Need::Programs(&["chromium"]);

impl Need {
    /// Whether a test that needs this can run. A variable that names no folder is an error of the test.
    pub fn is_there(self) -> bool {
        let in_path = |program: &&str| {
            let path = env::var_os("PATH").unwrap_or_default();
            env::split_paths(&path).any(|folder| folder.join(program).is_file())
        };
        match self {
            Self::Folder { variable } => env::var_os(variable).is_some(),
            Self::Programs(programs) => programs.iter().all(in_path),
        }
    }

    /// The folder that the variable names.
    pub fn folder(self) -> PathBuf {
        let Self::Folder { variable } = self else { panic!("programs are in no folder") };
        let folder = env::var_os(variable).unwrap_or_else(|| panic!("{variable} is not set"));
        let folder = Path::new(&folder).to_owned();
        assert!(folder.is_dir(), "{variable} names no folder: {}", folder.display());
        folder
    }

    pub fn name(self) -> String {
        match self {
            Self::Folder { variable } => variable.to_owned(),
            Self::Programs(programs) => programs.join(" "),
        }
    }
}
