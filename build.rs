//! Builds the C++ core with `CMake`, then the bridge to it with `cxx-build`, and generates the table of parameters.

use std::fmt::Write as _;
use std::path::Path;
use std::{env, fs};

const PARAMETERS: &str = "cpp/include/plenocal/parameters.def";

/// Generates a call of the macro in `src/model/parameters.rs` from the rows of the table, without the members in C++.
fn generate_parameters() {
    let table = fs::read_to_string(PARAMETERS).expect("the table of parameters can be read");
    let mut call = "parameters! {\n".to_owned();
    for row in table.lines().filter(|line| line.starts_with("PLENOCAL_")) {
        let (_, columns) = row.split_once('(').expect("a row has columns");
        let columns: Vec<&str> = columns.splitn(5, ", ").collect();
        let [id, name, unit, _, rest] = columns[..] else { panic!("a row has 7 columns: {row}") };
        writeln!(call, "({id}, {name}, {unit}, {rest};").expect("a text can be written");
    }
    let out = env::var_os("OUT_DIR").expect("cargo sets it");
    fs::write(Path::new(&out).join("parameters.rs"), call + "}\n").expect("OUT_DIR can be written");
}

fn main() {
    generate_parameters();
    // Always optimised: Ceres' Jets are about fifty times slower without inlining.
    let core = cmake::Config::new("cpp")
        .profile("Release")
        .define("PLENOCAL_BUILD_TESTS", "OFF")
        .define("PLENOCAL_BUILD_EXAMPLES", "OFF")
        .define("PLENOCAL_BUILD_IO", "OFF")
        .define("BUILD_SHARED_LIBS", "OFF")
        .define("CMAKE_INSTALL_LIBDIR", "lib")
        .build();
    cxx_build::bridge("src/solver/bridge.rs")
        .file("cpp/bridge/bridge.cpp")
        .include("cpp/bridge")
        .include(core.join("include"))
        .include("/usr/include/eigen3")
        // Ceres' headers include glog's, which need this since version 0.7; CMake's targets set it.
        .define("GLOG_USE_GLOG_EXPORT", None)
        .std("c++17")
        .compile("plenocal_bridge");

    // The order matters to linkers that read each library once: bridge, core, then what the core
    // needs.
    println!("cargo:rustc-link-search=native={}", core.join("lib").display());
    println!("cargo:rustc-link-lib=static=plenocal");
    println!("cargo:rustc-link-lib=dylib=ceres");
    println!("cargo:rustc-link-lib=dylib=glog");

    for path in [
        "build.rs",
        "src/solver/bridge.rs",
        "cpp/CMakeLists.txt",
        "cpp/cmake",
        "cpp/include",
        "cpp/src",
        "cpp/bridge",
    ] {
        println!("cargo:rerun-if-changed={path}");
    }
}
