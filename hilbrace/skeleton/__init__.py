"""The musculoskeletal model as figures, its kinematics and its scaling; no OpenSim."""
