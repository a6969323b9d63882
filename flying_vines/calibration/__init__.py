"""The calibration of a rig on the ground: what its pressures tell of its volumes, valves, leaks and sensors.

`plan` says which stages there are, what they take, and with which profile they move the vine; `calibrator`
is the machine that goes through them, without a clock, a port or a person of its own; each stage's telemetry
(`readings`) is made into `findings` by a function of its own. Needs numpy.
"""
