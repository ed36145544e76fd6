"""A rig calibrated and synchronised from its pictures: swings-capture calibrate."""
