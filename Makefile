# plenocal: everything a newcomer needs. `make demo` and `make test` install what is missing.

PACKAGES = g++ cmake make libceres-dev libeigen3-dev nlohmann-json3-dev libopencv-dev libclang-dev clang \
           clang-format libgtest-dev shellcheck
# What only `make test-all` needs: a browser, shells, a formatter of manual pages.
TOOLS = chromium zsh fish groff-base
# Packages are installed with sudo, except by root.
SUDO = $(if $(filter 0,$(shell id -u)),,sudo)
BUILD = build/cpp
JOBS = $(shell nproc)
MAKEFLAGS += --no-print-directory
# The C++ programs of the tests and benchmarks.
export PLENOCAL_EXAMPLES = $(CURDIR)/$(BUILD)/examples

.PHONY: help deps deps-all build demo cpp test test-all test-slow test-mistakes test-misuse test-faults test-large fuzz \
        test-cpp test-rust lint bench evidence sanitizers doc doc-cpp site data figures format clean

help:
	@echo "make demo       simulate a camera, calibrate it from its images, write a report"
	@echo "make test       the tests; PLENOCAL_R12A=DIR and PLENOCAL_WHITES=DIR add real data"
	@echo "make test-all   also reports in a browser, shell completions, manual pages; installs Chromium"
	@echo "make test-slow  the slow tests (Monte Carlo, bias of corners, large images)"
	@echo "make test-misuse    what becomes of 308 uses of a calibrated camera, wrong and right ones (some minutes)"
	@echo "make test-mistakes  what becomes of 500 users' mistakes and 100 clean sets (an hour)"
	@echo "make test-faults  kills, full and broken disks, pipes and links (some minutes)"
	@echo "make test-large   memory of every command on the largest input that it accepts (an hour; 20 GB of disk)"
	@echo "make fuzz       a million damaged files, solves, cameras in use and runs (half an hour); FUZZ=\"--cases N\" or a target"
	@echo "make lint       formatting, clippy, C++ warnings, documentation"
	@echo "make bench      speed, against a plain Ceres program, and how it grows (a quarter of an hour)"
	@echo "make evidence   the tables of measured figures in docs (three hours); PART=\"results accuracy/corners\" makes some"
	@echo "make sanitizers the C++ tests with address, undefined-behaviour and thread sanitizers, and shared"
	@echo "make doc        API documentation in target/doc"
	@echo "make doc-cpp    that of the C++ library in build/doc-cpp"
	@echo "make site       the documentation as pages in build/site; fails on dead links"
	@echo "make data       regenerate data/synthetic"
	@echo "make figures    regenerate docs/figures"
	@echo "make format     format all sources"
	@echo "make deps       install the Debian packages that are missing"

deps:
	@missing=""; for p in $(PACKAGES); do \
	  dpkg-query -W -f='$${Status}' $$p 2>/dev/null | grep -q 'ok installed' \
	    || missing="$$missing $$p"; done; \
	if [ -n "$$missing" ]; then \
	  echo "Installing$$missing (a minute or two)"; \
	  $(SUDO) apt-get update -qq && \
	  DEBIAN_FRONTEND=noninteractive $(SUDO) apt-get install -qq -y --no-install-recommends $$missing \
	    > /dev/null; \
	fi

build: deps
	@echo "Building plenocal (a few minutes the first time)"
	cargo build --release

demo: build
	cargo run --release --quiet -- demo --out out/demo

test: test-cpp test-rust

deps-all test-all: PACKAGES += $(TOOLS)
deps-all: deps
test-all: test

$(BUILD)/CMakeCache.txt: cpp/CMakeLists.txt | deps
	cmake -S cpp -B $(BUILD) -DCMAKE_BUILD_TYPE=Release --log-level=WARNING

cpp: $(BUILD)/CMakeCache.txt
	@echo "Building the C++ core and its tests (a minute or two the first time)"
	cmake --build $(BUILD) --parallel $(JOBS)

test-cpp: cpp
	ctest --test-dir $(BUILD) --output-on-failure --parallel $(JOBS)

test-rust: cpp
	cargo test --release --no-fail-fast
	$(if $(PLENOCAL_R12A),cargo test --release --lib -- --ignored r12a_)

# The names of the tests that are too slow for `make test`, or parts of them.
SLOW = monte_carlo bias a_frame_that_moved_is_named boards_are_seen_above_black full_pixels_show_below \
       rendered_spots_of_real_lenses corners_are_found_with_an_r12
test-slow: cpp
	cargo test --release --test it -- --ignored --nocapture $(SLOW)

# MISUSE="part of a name" and MISTAKES="part of a name" run some of them.
test-misuse: deps
	cargo test --release --test misuse -- $(if $(MISUSE),"$(MISUSE)")

test-mistakes: deps
	cargo test --release --test mistakes -- $(if $(MISTAKES),"$(MISTAKES)")

test-faults: deps
	cargo test --release --test faults

# LARGE="part of a name" runs some of them.
test-large: deps
	cargo test --release --test large -- $(if $(LARGE),"$(LARGE)")

# FUZZ="--cases N", "--from N", names of targets; "--show TARGET CASE" prints a case.
fuzz: deps
	cargo test --release --test fuzz -- $(FUZZ)

# The cmake crate silences C++ warnings; the plain build shows them, as errors.
lint: deps
	shellcheck .ci/run
	cargo fmt --check
	git ls-files 'cpp/*.hpp' 'cpp/*.cpp' | xargs clang-format --dry-run --Werror
	cmake -S cpp -B build/lint -DCMAKE_BUILD_TYPE=Release -DCMAKE_CXX_FLAGS=-Werror \
	  --log-level=WARNING
	cmake --build build/lint --parallel $(JOBS)
	cargo clippy --release --all-targets -- -D warnings
	cargo clippy --release --test mistakes --test misuse --test faults --test fuzz --test large -- -D warnings
	RUSTDOCFLAGS="-D warnings" cargo doc --release --no-deps --document-private-items

bench: cpp
	cargo bench

# PART="results accuracy/corners", all parts of a page and one part of another; PART=--list lists them; PART="--quick results"
# tries parts on small sets, and prints their tables.
evidence: build cpp
	cargo run --release --example evidence -- $(PART)

# Every C++ test with AddressSanitizer and UndefinedBehaviorSanitizer, and those of threads with
# ThreadSanitizer, by both compilers. PRESETS="asan-gcc" runs some.
PRESETS = asan-gcc asan-clang tsan-gcc tsan-clang shared
sanitizers: PACKAGES += libclang-rt-dev
sanitizers: deps
	cd cpp && for preset in $(PRESETS); do \
	  echo "== $$preset"; \
	  cmake --preset $$preset --log-level=WARNING && cmake --build --preset $$preset --parallel $(JOBS) \
	    && ctest --preset $$preset || exit 1; \
	done

doc-cpp: PACKAGES += doxygen
doc-cpp: deps
	mkdir -p build/doc-cpp
	cd cpp && doxygen
	@echo "build/doc-cpp/html/index.html"

doc: deps
	cargo doc --release --no-deps --open

# Dead links, dead anchors and pages outside the navigation are errors. Neither this nor the pages load anything from
# the network.
site: PACKAGES = python3-myst-parser furo
site: deps
	rm -rf build/site build/doctrees
	sphinx-build -q -W --keep-going -c docs/site -d build/doctrees . build/site
	cp build/site/README.html build/site/index.html
	mkdir build/site/api
	if [ -d target/doc/plenocal ]; then cp -r target/doc build/site/api/rust; fi
	if [ -d build/doc-cpp/html ]; then cp -r build/doc-cpp/html build/site/api/cpp; fi
	@echo "build/site/index.html"

data: deps
	cargo run --release --example synthetic_dataset -- data/synthetic

figures: deps
	cargo run --release --example figures -- docs/figures

format: deps
	cargo fmt
	git ls-files 'cpp/*.hpp' 'cpp/*.cpp' | xargs clang-format -i

clean:
	rm -rf build out
	cargo clean
