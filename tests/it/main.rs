//! Tests of whole stages and of the command line.
//!
//! Some need data or programs that are not always available, and are reported as ignored without
//! them. Environment variables name these:
//! `PLENOCAL_R12A` the folder of the real R12-A observations, `PLENOCAL_WHITES` that of real white
//! images, `PLENOCAL_EXAMPLES` the programs of `cpp/examples`, `PLENOCAL_CHROMIUM` a browser;
//! `PLENOCAL_TOOLS` says that bash, zsh, fish and groff are installed.

mod anchors;
mod aperture_ratio;
mod assessment;
mod bad_input;
mod bad_values;
mod board;
mod board_files;
mod board_scatter;
mod command_line;
mod compote;
mod damaged;
mod detect;
mod detection;
mod floors;
#[path = "../hostile/mod.rs"]
mod hostile;
mod house;
mod independent;
mod init;
#[cfg(unix)]
mod interrupt;
mod likeness;
mod linear_light;
mod manners;
mod micro_images;
mod models;
mod modes;
mod oracle;
mod own_programs;
mod precalibrate;
mod precalibration;
mod prepared;
mod r12a;
mod real_lenses;
mod recovery;
mod report;
mod run;
mod simulate;
mod simulation;
mod support;
mod uncertainty;
mod use_camera;
mod weights;
