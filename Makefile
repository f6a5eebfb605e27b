# Each target first sets up what it needs: a sourced ROS 2, or else a private environment.

PYTHON ?= python3
export PYTHON
# Three nodes and two test workers share the cores: BLAS threads would only fight over them.
export OPENBLAS_NUM_THREADS ?= 1

RUN := scripts/in_environment
BIN := $(RUN) install/dlsc_qbs_ros/lib/dlsc_qbs_ros
NUMPY126 := scripts/in_environment --numpy126
BENCH := scripts/in_environment --bench
PYTEST := python3 -m pytest -n 2 --dist loadfile

.PHONY: demo test build bench table reproduce clean lock

# ODOMETRY=mavlink: from a simulated autopilot over UDP, in real time.
ODOMETRY ?= nav_msgs
demo: build
	$(RUN) python3 -m dlsc_qbs_ros.cli.demo --odometry $(ODOMETRY) --out demo_output

test: build
	$(RUN) $(PYTEST)
	$(NUMPY126) $(PYTEST)

# From nothing each time, it takes seconds: no file that left the sources stays installed.
build:
	@$(RUN) true
	rm -rf build install
	$(RUN) colcon build --paths . --event-handlers console_direct- || \
		{ cat log/latest_build/dlsc_qbs_ros/stdout_stderr.log; exit 1; }

bench: build
	set -e; for file in $(sort $(wildcard benchmarks/bench_*.py)); do $(BENCH) python3 $$file; done

# The table of the README: three kinds of flight, three seeds of each, and what makes two of them
# harder; one configuration for all.
TABLE := table_output
SEEDS := 0 1 2
HARDER := second-altitude reversed-lap pause dimmed twin-aisle
table: build
	rm -rf $(TABLE)
	set -e; for flight in 1 2 3; do for seed in $(SEEDS); do \
		$(BIN)/simulate --flight $$flight --seed $$seed --encoding mono8 \
			--out $(TABLE)/flight$${flight}_seed$$seed; \
	done; done
	set -e; for flight in 2 3; do for harder in $(HARDER); do \
		$(BIN)/simulate --flight $$flight --seed 0 --encoding mono8 --$$harder \
			--out $(TABLE)/flight$${flight}_$$harder; \
	done; done
	$(BIN)/evaluate $(TABLE)/flight* --encoder dlsc_qbs,dlsc_qbs_paper,oracle \
		--jobs 2 --out $(TABLE)/rows

# LatentSLAM's row is trained with PyTorch. Where that cannot be had, the report says what it lacks.
TORCH := torch==2.13.0
reproduce: build
	-$(RUN) sh -c 'python3 -c "import torch" 2>/dev/null || \
		python3 -m pip install --disable-pip-version-check --progress-bar off $(TORCH)'
	$(BIN)/reproduce --jobs 2 --out reproduce_output

clean:
	rm -rf build install log .venv .venv-numpy126 .venv-bench .pytest_cache
	rm -rf demo_output bench_output reproduce_output $(TABLE)
	find . -name __pycache__ -prune -exec rm -rf {} +

lock:
	$(PYTHON) scripts/lock.py requirements.txt python3.10 python3.11 python3.12 python3.13 \
		> requirements.lock.new
	mv requirements.lock.new requirements.lock
	$(PYTHON) scripts/lock.py requirements-numpy126.txt python3.10 python3.11 python3.12 \
		> requirements-numpy126.lock.new
	mv requirements-numpy126.lock.new requirements-numpy126.lock
	$(PYTHON) scripts/lock.py requirements-bench.txt python3.10 python3.11 python3.12 python3.13 \
		> requirements-bench.lock.new
	mv requirements-bench.lock.new requirements-bench.lock
