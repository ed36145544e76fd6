import js from "@eslint/js";
import globals from "globals";

/** Paths are relative to the root of the repository, where `npm run lint` starts eslint. */
export default [
  { ignores: ["player/web/bundle/", "player/web/dist/", "**/node_modules/"] },
  js.configs.recommended,
  { linterOptions: { reportUnusedDisableDirectives: "error" } },
  {
    rules: {
      eqeqeq: ["error", "always", { null: "ignore" }],
      "no-unused-vars": ["error", { argsIgnorePattern: "^_" }],
      "prefer-const": "error",
    },
  },
  { files: ["**/*.js"], languageOptions: { globals: { ...globals.browser, ...globals.worker } } },
  {
    files: ["**/*.mjs", "player/web/tools/*.js"],
    languageOptions: { globals: globals.node },
  },
];
