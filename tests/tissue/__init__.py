"""Tests of the organ."""
