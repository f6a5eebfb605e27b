# Each target first sets up what it needs: a sourced ROS 2, or else a private environment.

PYTHON ?= python3
export PYTHON
# Three nodes and two test workers share the cores: BLAS threads would only fight over them.
export OPENBLAS_NUM_THREADS ?= 1

RUN := scripts/in_environment
NUMPY126 := scripts/in_environment --numpy126
PYTEST := python3 -m pytest -n 2 --dist loadfile

.PHONY: demo test build bench clean lock

demo: build
	$(RUN) python3 -m dlsc_qbs_ros.cli.demo --out demo_output

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
	set -e; for file in $(sort $(wildcard benchmarks/bench_*.py)); do $(RUN) python3 $$file; done

clean:
	rm -rf build install log .venv .venv-numpy126 .pytest_cache demo_output bench_output
	find . -name __pycache__ -prune -exec rm -rf {} +

lock:
	$(PYTHON) scripts/lock.py requirements.txt python3.10 python3.11 python3.12 python3.13 \
		> requirements.lock.new
	mv requirements.lock.new requirements.lock
	$(PYTHON) scripts/lock.py requirements-numpy126.txt python3.10 python3.11 python3.12 \
		> requirements-numpy126.lock.new
	mv requirements-numpy126.lock.new requirements-numpy126.lock
