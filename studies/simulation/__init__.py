"""Preparation and run of a scenario: mesh, assembly, steps and records."""

from studies.simulation.simulation import Simulation, prepare

__all__ = ["Simulation", "prepare"]
