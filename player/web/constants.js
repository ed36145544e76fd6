/** Written by scripts/webmodules from the package's own constants. */

// pyproject.toml
export const PLAYER_VERSION = "0.1.0";

// player.render.project
export const LOW_PASS_PX2 = 0.3;
export const JACOBIAN_CLAMP = 1.3;
export const ALPHA_MAX = 0.99;
export const ALPHA_MIN = 0.00392156862745098;
export const MAX_EXTENT_SIGMA = 3.33;
export const SH_C1 = 0.4886025119029199;
export const SH_C2 = [1.0925484305920792, 0.31539156525252005, 0.5462742152960396];
export const SH_C3 = [
  0.5900435899266435, 2.890611442640554, 0.4570457994644658, 0.3731763325901154, 1.445305721320277,
];
export const COLOUR_TURN_RAD = 0.002;

// player.render.upload
export const COLOUR_COLUMNS = 2048;
export const MOVES = 1;
export const ENTERS = 2;
export const LEAST_SPARE = 64;
export const SPARE_SHARE = 16;

// codec.splats
export const SH_C0 = 0.28209479177387814;
export const MAX_SH_DEGREE = 3;

// codec.slice
export const MAX_SWIN_SIZE = 255;
export const HIDDEN = 255;
export const JUMP_SIGMAS = 8;

// codec.camera
export const MAX_IMAGE_PX = 16384;

// codec.stream.manifest
export const VERSION = 1;
export const MAX_MANIFEST_BYTES = 1048576;
export const MAX_CAMERAS = 256;
export const MIN_FPS = 0.001;
export const MAX_FPS = 1000;
export const MAX_TEXT_CHARS = 2000;
export const MAX_POSTER_BYTES = 255;

// codec.stream.reader
export const DEFAULT_MAX_GAUSSIANS = 4194304;
export const FLOAT_COPIES = 5;

// codec.slots.slotlayout
export const MAX_SLOTS = 1048576;
export const MAX_NUM_GS = 16777216;
export const MAX_SEGMENT_SLOTS = 268435456;
export const MAX_LAYERS = 16;
export const MAX_SEGMENT_FRAMES = 4096;
export const MAX_CHUNK_BYTES = 248512624;
export const COUNTS_BYTES = 20;
export const CHUNK_MAGIC = "SWG1";
export const CHUNK_HEAD = "<4sBBBBi";
export const CHUNK_KINDS = { SKIP_MAP: 0, CHANGE: 1, KEYFRAME: 2 };
export const HAS_STARTS = 1;
export const KEPT = 0;
export const ENDED = 1;
export const PREDICTED = 2;
export const NEW = 3;

// codec.lattice.lattice
export const POSITION_LIMIT = 8388608;
export const MIN_STEP = 1e-6;
export const MAX_STEP = 1000000;
export const MAX_BASE = 1000;

// codec.lattice.forms
export const MAX_OPACITY_LEVELS = 256;
export const MAX_LOGIT = 16;

// codec.slots.change
export const CHANGE_COUNTS = "<5I";
export const LONG = 255;
export const MAX_GAP_BITS = 25;

// codec.slots.skipmap
export const CONTEXTS = 37;
export const FIRST_OF_B = 32;
export const CONTEXT_OF_C = 36;

// codec.slots.rangecoder
export const WHOLE_RANGE = 4294967295;
export const LEAST_RANGE = 16777216;
export const FIRST_PROBABILITY = 32768;
export const MOST_COUNTED = 127;

// codec.slots.state
export const UNKNOWN = 0;
export const EMPTY = 1;
export const ON_LATTICE = 2;
export const ESCAPED = 3;

// codec.slots.decoder
export const MIN_LOG_BYTES = 16777216;
export const LOG_SHARE = 6;

// codec.stream.segment
export const CODER = 2;
export const SKIPPABLE_MAGIC = 407710288;
export const TABLE_MAGIC = "SWGO";
export const OBJECT_HEAD = "<II4sBBHI";
export const OBJECT_ENTRY = "<iII";
export const MAX_CHUNKS = 16384;
export const MAX_OBJECT_BYTES = 1073741824;
export const INDEX_HEAD = "<IIII";
export const INDEX_LAYER = "<Q32sf";
export const INDEX_SIDE = "<Q32s";
export const INDEX_CHECKSUM = "<I";

// codec.coders.zstd
export const ZSTD_MAGIC = [40, 181, 47, 253];
export const MAX_EXPANSION = 32768;

// codec.coders.planes
export const NUM_CODES = 32;
export const MOST_ONES = 12;
export const MOST_LOW_BITS = 8;
export const LENGTH_BITS = 3;
export const MOST_LENGTH = 7;
export const CODE_BITS = 5;
export const CENTRE_BITS = 8;

// codec.slots.changepacket
export const CODED = 1;
export const CODED_HEAD = "<BBBBi";
export const SH_DEGREE_BITS = 2;

// codec.stream.integrity
export const MAX_INDEX_BYTES = 268435456;

// codec.stream.captions
export const MAX_CAPTIONS = 16;
export const MAX_CAPTIONS_BYTES = 1048576;

// codec.stream.pictures
export const MAX_PICTURE_BYTES = 1048576;

// codec.stream.packedlayout
export const ZIP_LOCAL = "<IHHHHHIIIHH";
export const ZIP_LOCAL_MAGIC = 67324752;
export const PACKED_SUFFIX = ".swings";
export const PACKED_EXTRA = "<HHHHIIII";
export const PACKED_EXTRA_ID = 22355;
export const PACKED_VERSION = 1;
export const FIRST_PACKED_BYTES = 32768;

// codec.stream.playrecord
export const PACKETS_KEY = "packets";
export const MAX_RECORD_BYTES = 67108864;
export const MAX_MESSAGE_CHARS = 500;
export const MAX_KEYS = 8;
export const MAX_ITEMS = 16;
export const MAX_TEXT_BYTES = 65536;

// codec.stream.sound
export const SAMPLE_RATE = 48000;
export const PREROLL = 3840;
export const MAX_SOURCES = 16;
export const MAX_SOUND_KEYS = 256;
export const MAX_PACKETS = 65536;
export const MAX_SOUND_BYTES = 16777216;
export const MAX_POSITION = 4503599627370496;
export const MAX_PACKET_SAMPLES = 5760;
export const SOUND_PREFIX = "audio-";
export const SOUND_MAGIC = "SWA1";
export const SOUND_HEAD = "<4sIIBBHIQQ";

// codec.stream.poster
export const MAX_STORYBOARD_TILES = 60;
export const STORYBOARD_COLUMNS = 10;
export const STORYBOARD_PER_S = 4;

/**
 * codec.stream.playrecord
 * @typedef {{ kind: "start", fromFrame: number, numFrames: number, manifest: Uint8Array }} StartRecord
 * @typedef {{ kind: "slice", birth: number, packets: Uint8Array[], skipMap: Uint8Array | null, firstLayer: number }} SliceRecord
 * @typedef {{ kind: "keyframe", frame: number, firstLayer: number, packets: Uint8Array[] }} KeyframeRecord
 * @typedef {{ kind: "end", numFrames: number }} EndRecord
 * @typedef {{ kind: "error", message: string }} ErrorRecord
 * @typedef {StartRecord | SliceRecord | KeyframeRecord | EndRecord | ErrorRecord} PlayRecord
 */
