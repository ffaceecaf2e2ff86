# The same commands as in .ci/run and CONTRIBUTING.md, by short names.
.DEFAULT_GOAL := help
.PHONY: help install format check lint types schemas test quick quickstart site ci clean

help: ## show this list
	@awk -F ':.*## ' '/^[a-z]+:.*## / {printf "  %-12s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

install: ## install the project in place, with everything for development
	pip install -e '.[dev]'

format: ## put the code into the project's format, mend what ruff can mend
	ruff format .
	ruff check --fix .

check: lint types schemas ## everything that reads the code without running the tests

lint: ## format and style
	ruff format --check .
	ruff check .
	lint-imports

types: ## static types
	mypy

schemas: ## schemas/ agrees with the models
	python -m spl_batch.engine.report.schema --check

test: ## all tests
	python -m pytest

quick: ## tests that take less than a few seconds each
	python -m pytest -m 'not slow'

quickstart: ## simulate a small survey and run the whole chain on it
	spl-batch quickstart

site: ## the documentation as a site, in build/site
	mkdocs build --strict

ci: ## everything, in a fresh environment
	.ci/run

clean: ## remove caches and the quickstart's folder
	rm -rf .hypothesis .mypy_cache .pytest_cache .ruff_cache build dist spl-quickstart
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
