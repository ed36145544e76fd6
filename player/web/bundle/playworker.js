import"./streamplayer.js";
