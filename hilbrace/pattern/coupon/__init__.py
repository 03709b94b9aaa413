"""Test pieces for a tensile machine: the plate, the force it should take, and the modulus of its rubber."""
