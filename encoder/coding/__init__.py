"""From trained values to packets within a budget: requantisation, packet kinds, rate and time control."""
