"""From trained values to packets within a budget: quantised changes, packet kinds, rate and time control."""
