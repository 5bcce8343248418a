"""Light through volumes and onto surfaces, on NVIDIA Warp; only what a scene calls for runs."""
