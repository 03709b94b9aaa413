"""The optimizer: losses, the joint's response, the loop, and the uniform design to compare with."""
