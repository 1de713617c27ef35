"""Benchmarks: suites of tasks, a runner that survives what it runs, and reports."""
