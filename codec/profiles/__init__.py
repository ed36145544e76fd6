"""How exactly a chunk says its Gaussians: raw floats, the paper's quantisation, or compact."""
