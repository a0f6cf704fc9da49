"""A scenario is prepared and run: mesh, assembly, steps, and what is recorded of them."""

from studies.simulation.simulation import Simulation, prepare

__all__ = ["Simulation", "prepare"]
