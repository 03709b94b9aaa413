"""From structured-light pictures or a scanner's mesh to the surface of a limb."""
