"""The backend that runs on the processor: native kernels, the same bits for the same seed."""
