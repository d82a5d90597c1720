//! Builds the C++ core with `CMake`, then the bridge to it with `cxx-build`.

fn main() {
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

    // Tests that need something from outside the repository are reported as ignored without it.
    for (variable, cfg) in [
        ("PLENOCAL_R12A", "plenocal_r12a"),
        ("PLENOCAL_WHITES", "plenocal_whites"),
        ("PLENOCAL_EXAMPLES", "plenocal_examples"),
        ("PLENOCAL_CHROMIUM", "plenocal_chromium"),
        ("PLENOCAL_TOOLS", "plenocal_tools"),
    ] {
        println!("cargo:rerun-if-env-changed={variable}");
        println!("cargo:rustc-check-cfg=cfg({cfg})");
        if std::env::var_os(variable).is_some() {
            println!("cargo:rustc-cfg={cfg}");
        }
    }

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
