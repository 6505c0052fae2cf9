# Two commands on a fresh machine: `make demo` and `make test`. Everything else is for contributors.
PYTHON ?= python3
VENV ?= .venv
RUN := $(VENV)/bin
OUT ?= out/demo
# Tests run side by side, whole files at a time: most of their time goes into compiling.
JOBS ?= 2
PYTEST := $(RUN)/python -m pytest --numprocesses $(JOBS) --dist loadfile --no-loadscope-reorder \
	--durations 40 --durations-min 5
# One thread for each numerical library: on few cores more of them only get in each other's way.
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1

.PHONY: demo docs notebooks wheel test test-all lint bench bench-gate blind blind-quick validation validation-quick setup clean
.DEFAULT_GOAL := test

setup: $(VENV)/.ready

$(VENV)/.ready: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))' || \
		{ echo "Python 3.11, 3.12 or 3.13 is needed (set PYTHON=...), found $$($(PYTHON) --version)"; exit 2; }
	@test -x $(RUN)/python || $(PYTHON) -m venv $(VENV) || \
		{ echo "Could not make a virtual environment; on Debian: apt install python3-venv"; exit 2; }
	$(RUN)/python -m pip install --quiet --upgrade pip
	$(RUN)/python -m pip install --quiet -c constraints.txt -e '.[jaxopt]' --group test --group lint
	@touch $@

$(VENV)/.docs-ready: $(VENV)/.ready
	$(RUN)/python -m pip install --quiet -c constraints.txt --group docs
	@touch $@

demo: setup
	$(RUN)/wrapjax demo --out $(OUT) --force

# Pages in out/docs/html; warnings are errors, and the examples of all pages are run. Nothing is downloaded.
SPHINX := $(RUN)/python -m sphinx --fail-on-warning --keep-going --quiet -d out/docs/doctrees
docs: $(VENV)/.docs-ready
	$(SPHINX) --builder html docs out/docs/html
	$(SPHINX) --builder doctest docs out/docs/doctest
	@echo "open out/docs/html/index.html in a browser"

# Executes the notebooks (minutes), and stores them with what they print and draw.
notebooks: $(VENV)/.docs-ready
	$(RUN)/python docs/execute_notebooks.py

wheel: setup
	$(RUN)/python -m pip wheel --quiet --no-deps --wheel-dir dist .

test: setup
	$(PYTEST) -m "not slow and not gpu"

test-all: setup
	$(PYTEST)

lint: setup
	$(RUN)/ruff check .
	$(RUN)/ruff format --check .
	$(RUN)/mypy

bench: setup
	$(RUN)/python -m benchmarks $(BENCH)

# Whether a change made anything worse; AGAINST=FILE.json, which `make bench-gate BENCH='--out FILE.json'` wrote
# before it, compares with what it was then.
bench-gate: setup
	$(RUN)/python -m benchmarks.gate $(if $(AGAINST),--against $(AGAINST)) $(BENCH)

# Cases from a simulator that shares nothing with the model, diagnosed and scored; both go on where they were
# stopped. Their folder, the bank, how many of its cases, and starts of each calibration:
blind: BANK = out/blind test 720 4
blind-quick: BANK = out/blind-quick development 40 2
ANSWERERS := wrapjax modification_index raw_correlation held_out_drop score_alone without_input_errors \
	without_muscle_errors without_repeated without_nuisances without_give

blind blind-quick: setup
	$(RUN)/python -m validation.blind make --out $(word 1,$(BANK)) --bank $(word 2,$(BANK)) \
		--cases $(word 3,$(BANK)) --workers $(JOBS)
	$(RUN)/python -m validation.diagnosis.diagnose_bank --bank $(word 1,$(BANK)) --out $(word 1,$(BANK))/answers/wrapjax \
		--baselines $(word 1,$(BANK))/answers --ablations $(word 1,$(BANK))/answers \
		--withheld $(word 1,$(BANK))/answers/withheld \
		--starts $(word 4,$(BANK)) --workers $(JOBS)
	$(RUN)/python -m validation.blind score --bank $(word 1,$(BANK)) --json $(word 1,$(BANK))/score.json \
		$(foreach name,$(ANSWERERS),--answers $(name)=$(word 1,$(BANK))/answers/$(name)) \
		--withheld wrapjax=$(word 1,$(BANK))/answers/withheld
	$(RUN)/python -m validation.blind publish --score $(word 1,$(BANK))/score.json --out $(word 1,$(BANK))/published

# Cases of eight simulated worlds: decisions on each with constants that were fitted on the others. The bank and the
# linearised models go on where they were stopped; the quick one takes about an hour. Folder, and how many cases:
validation: WORLDS = out/validation 320
validation-quick: WORLDS = out/validation-quick 64

validation validation-quick: setup
	$(RUN)/python -m validation.blind make --out $(word 1,$(WORLDS)) --bank worlds --cases $(word 2,$(WORLDS)) \
		--workers $(JOBS)
	$(RUN)/python -m validation.diagnosis.linearizations --bank $(word 1,$(WORLDS)) --out $(word 1,$(WORLDS))/lines \
		--workers $(JOBS)
	$(RUN)/python -m validation.diagnosis.left_out_worlds --bank $(word 1,$(WORLDS)) --lines $(word 1,$(WORLDS))/lines

clean:
	rm -rf $(VENV) out .pytest_cache .ruff_cache .mypy_cache
