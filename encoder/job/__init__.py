"""What an encode is asked for: job, method and its parts, targets, and option texts."""
