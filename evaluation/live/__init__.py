"""What the laboratory sees while it measures: knee angles, forces, peaks, and the health of the devices."""
