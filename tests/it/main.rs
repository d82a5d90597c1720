//! Tests of whole stages and of the command line.

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
mod image_input;
mod init;
#[cfg(unix)]
mod interrupt;
mod likeness;
mod linear_light;
mod manners;
mod micro_images;
mod models;
mod modes;
mod openings;
mod oracle;
mod own_programs;
mod precalibrate;
mod precalibration;
mod prepared;
mod priors;
mod real_lenses;
mod recovery;
mod report;
mod run;
mod simulate;
mod simulation;
mod support;
mod traced_lenses;
mod uncertainty;
mod unusual_arrays;
mod use_camera;
mod weights;
