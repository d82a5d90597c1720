//! Tests of whole stages and of the command line.
//!
//! Those on the real R12-A observations need `PLENOCAL_R12A`, the folder that holds them; those
//! against the independent Ceres program need `PLENOCAL_PLAIN_CERES`, its executable; that of reports
//! in a browser needs `PLENOCAL_CHROMIUM`, its name.

mod bad_input;
mod command_line;
mod compote;
mod detection;
mod floors;
mod independent;
mod init;
#[cfg(unix)]
mod interrupt;
mod manners;
mod modes;
mod oracle;
mod precalibration;
mod r12a;
mod recovery;
mod report;
mod run;
mod simulation;
mod support;
