import"./playcontroller.js";
