"""What a stream looks like against a camera that training never saw: metrics, regions, frames, all of them together."""
