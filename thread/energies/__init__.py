"""Elastic energies of the thread, each with its exact derivatives: stretch and bend, springs,
torsion, coil.
"""
