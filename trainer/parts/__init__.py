"""A capture in parts that are trained side by side, and joined into one stream without a seam."""
