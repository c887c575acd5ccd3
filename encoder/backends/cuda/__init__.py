"""The backend that runs on a CUDA device, through gsplat."""
