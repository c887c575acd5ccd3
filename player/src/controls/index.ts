/** The controls: a script of their own, which comes behind the first picture. */
export { forgetKeys, looksInto } from "./keys";
export { Panels } from "./panels";
