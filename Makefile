# Everything starts with `make demo`; `make help` lists the rest.

.DEFAULT_GOAL := help
.NOTPARALLEL:
.PHONY: help demo test lint docs clean reference reference-check release env env-dev gl browser

# REQUIRE_RENDERING=1 makes the rendering tests fail, instead of skip, where there is no OpenGL;
# REQUIRE_BROWSER=1 does the same for the tests of the HTML page, where there is no browser.
export LIEEDNN_REQUIRE_RENDERING := $(REQUIRE_RENDERING)
export LIEEDNN_REQUIRE_BROWSER := $(REQUIRE_BROWSER)
export PYTHON

help:
	@echo "make demo    plan, simulate, render and report one motion    (ARGS='--help' for its options)"
	@echo "make test    lint, types and tests                           (REQUIRE_RENDERING=1: no OpenGL is a failure;"
	@echo "                                                              REQUIRE_BROWSER=1: no Chromium is one)"
	@echo "make lint    lint and types alone"
	@echo "make docs    build the site in docs/_build/html"
	@echo "make reference        make results below results/reference again (ARGS='NAME ...', see docs/development/references.md)"
	@echo "make reference-check  compare samples of them with what today's code makes"
	@echo "make release          build the packages in dist/ and check them, unless a sample differs"
	@echo "make clean   remove caches and built packages; keeps .venv and results"
	@echo "Each makes .venv when it is missing; PYTHON=... chooses the interpreter (3.11, 3.12 or 3.13)."

demo: env gl
	.venv/bin/lieednn-sim demo $(ARGS)

test: lint gl browser
	.venv/bin/python -m pytest -n 3

lint: env-dev
	.venv/bin/ruff check
	.venv/bin/ruff format --check
	.venv/bin/mypy

docs: env-dev gl
	.venv/bin/sphinx-build -W --keep-going -q -d docs/_build/doctrees docs docs/_build/html

reference: env-dev gl
	.venv/bin/python scripts/reference.py $(ARGS)

reference-check: env-dev
	.venv/bin/python scripts/reference.py --check $(ARGS)

release: reference-check
	rm -rf dist
	.venv/bin/python -m build
	.venv/bin/python -m twine check --strict dist/*

clean:
	rm -rf build dist docs/_build docs/api/_made docs/gallery/_made .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find lieednn_sim tests scripts -type d -name __pycache__ -prune -exec rm -rf {} +

env:
	@scripts/ensure_env.sh

env-dev:
	@scripts/ensure_env.sh dev

# After the environment, which the callers make first.
gl:
	@scripts/ensure_gl.sh

# Chromium for the tests of the HTML page.
browser:
	@scripts/ensure_browser.sh
