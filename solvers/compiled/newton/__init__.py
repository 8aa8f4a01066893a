"""Newton ascent on the dual of `min_norm`, eight problems side by side in SIMD lanes."""
