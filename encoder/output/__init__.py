"""What an encode writes: the stream while it grows, reports, logs, and what a later encode resumes."""
