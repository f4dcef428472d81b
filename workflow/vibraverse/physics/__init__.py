"""Elasticity, eigensolvers, modal basis, materials, damping and impulse response: arrays in, arrays out."""
