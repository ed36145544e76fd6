/** Rendering recipe v1: the constants that every back end shares (player/render/recipe.py). */

export const LOW_PASS_PX2 = 0.3;
export const JACOBIAN_CLAMP = 1.3;
export const ALPHA_MAX = 0.99;
export const ALPHA_MIN = 1 / 255;
export const MAX_EXTENT_SIGMA = 3.33;
export const SH_C0 = 0.28209479177387814;
export const SH_C1 = 0.4886025119029199;
/** The constant and the linear harmonics are drawn; a stream may have more. */
export const MAX_DRAWN_SH_DEGREE = 1;
