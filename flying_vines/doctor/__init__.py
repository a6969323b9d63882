"""`flying-vines doctor`: checks whether you may fly, and shows what is wrong and how to correct it.

`look/` and the two probes gather facts about this computer, the vehicle and the phloSAR. `checks/` are
pure and turn facts into findings. `examine` runs all in order; `show` prints. The doctor sends no setpoint.
It requests version, time and settings from the phloSAR (the request for its version, Hello, vents the vine),
and messages, parameters, version and mission from the vehicle.

`radio_test` is a separate test, `doctor --radio`: is a lost transmitter detected? `radio_guide` leads the
user through it, `checks/receiver` judges the result, and `cli/doctor_radio` prints it and edits the
configuration file.
"""
