"""Gradients of the CPU rasteriser; its forward kernels stand in player.render."""
