"""What a hand feels: force and torque of an instrument at 1 kHz, from the state that the simulation's steps leave."""
