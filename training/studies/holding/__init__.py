"""Which forces hold: shaking, prediction, physics, and the study of survival."""
