"""Tests of scenarios, runs, output, the command line and the studies."""
