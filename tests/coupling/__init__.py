"""Tests of the coupled system."""
