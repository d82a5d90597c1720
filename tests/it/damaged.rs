//! Damaged files of every kind are read or refused: no panic, no hang, an error that names the file, and no number
//! that is not finite. `make fuzz` does the same a million times.

use rand::SeedableRng;
use rand::rngs::StdRng;

use crate::hostile::in_use::SETS;
use crate::hostile::mutation::damaged;
use crate::hostile::readers::{TARGETS, Target};
use crate::hostile::solving;
use crate::hostile::verdict::judge;

/// Damaged files of each reader.
const CASES: u64 = 1_000;
/// Damaged cameras of each use.
const USED: u64 = 200;
/// Damaged sets that are solved.
const SOLVED: u64 = 100;

/// Judges damaged files of a target, and that its valid files are accepted.
fn survives(target: &Target) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(target.file);
    let seeds = (target.seeds)();
    let accepted = seeds.iter().filter(|seed| judge(target, &path, seed) == Ok(true)).count();
    assert!(accepted > 0, "{}: no valid file is accepted", target.name);
    for case in 0..CASES {
        let mut random = StdRng::seed_from_u64(case);
        let seed = &seeds[usize::try_from(case).unwrap() % seeds.len()];
        let bytes = damaged(seed, &mut random);
        if let Err(finding) = judge(target, &path, &bytes) {
            let shown: String = String::from_utf8_lossy(&bytes).chars().take(2_000).collect();
            panic!("{}, case {case}: {finding}\n{shown}", target.name);
        }
    }
}

#[test]
fn damaged_files_are_read_or_refused() {
    let failed: Vec<&str> = TARGETS
        .iter()
        .filter(|target| std::panic::catch_unwind(|| survives(target)).is_err())
        .map(|target| target.name)
        .collect();
    assert!(failed.is_empty(), "{failed:?}");
}

/// What is read goes into the checks of the core, whose own would end the process.
#[test]
fn damaged_sets_are_solved_or_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(solving::SOLVING.file);
    for case in 0..SOLVED {
        let bytes = solving::case(&mut StdRng::seed_from_u64(case));
        if let Err(finding) = judge(&solving::SOLVING, &path, &bytes) {
            let shown: String = String::from_utf8_lossy(&bytes).chars().take(2_000).collect();
            panic!("case {case}: {finding}\n{shown}");
        }
    }
}

/// Valid cameras are used, and damaged ones are used or refused.
#[test]
fn damaged_cameras_are_used_or_refused() {
    let folder = tempfile::tempdir().unwrap();
    for set in &SETS {
        let path = folder.path().join(set.target.file);
        // Some are of another camera, or of a kind that is refused.
        let valid = set.valid();
        let accepted = valid.iter().filter(|case| judge(&set.target, &path, case) == Ok(true));
        assert!(2 * accepted.count() > valid.len(), "{}: valid files are refused", set.target.name);
        for case in 0..USED {
            let bytes = set.case(&mut StdRng::seed_from_u64(case));
            if let Err(finding) = judge(&set.target, &path, &bytes) {
                let shown: String = String::from_utf8_lossy(&bytes).chars().take(2_000).collect();
                panic!("{}, case {case}: {finding}\n{shown}", set.target.name);
            }
        }
    }
}
