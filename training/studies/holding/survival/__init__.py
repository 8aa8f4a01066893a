"""Does quality predict holding? Static measures of forces against survival in the simulator."""
