"""The training step on a device of torch, by gsplat or by plain torch; which backend is taken."""
