/** The page's build makes a text of it, without what is there for readers only. */
declare module "*.css" {
  const text: string;
  export default text;
}
