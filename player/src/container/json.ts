/** JSON as the header packet has it (SPEC section 4): stricter than JSON.parse, which forgets what integers are. */

import { refuse } from "./errors";
import { MAX_HEADER_NESTING } from "./limits";

/** A number and whether it was written without fraction and exponent. */
export class JsonNumber {
  constructor(
    readonly value: number,
    readonly integer: boolean,
  ) {}
}

export type JsonValue = null | boolean | string | JsonNumber | JsonValue[] | JsonObject;
export type JsonObject = Map<string, JsonValue>;

const NUMBER = /-?(?:0|[1-9][0-9]*)(?:\.[0-9]+)?(?:[eE][+-]?[0-9]+)?/y;
/** Runs of characters that stand for themselves in a text. */
const PLAIN = /[^"\\\u0000-\u001f]*/y;
const HALF_PAIR = /[\ud800-\udbff](?![\udc00-\udfff])|(?<![\ud800-\udbff])[\udc00-\udfff]/;
const SPACE = /[ \t\n\r]*/y;
const ESCAPES: Readonly<Record<string, string>> = {
  '"': '"',
  "\\": "\\",
  "/": "/",
  b: "\b",
  f: "\f",
  n: "\n",
  r: "\r",
  t: "\t",
};

export function parseJson(bytes: Uint8Array): JsonValue {
  return new Parser(decodeText(bytes)).whole();
}

function decodeText(bytes: Uint8Array): string {
  try {
    return new TextDecoder("utf-8", { fatal: true, ignoreBOM: true }).decode(bytes);
  } catch {
    return bad("the header is not UTF-8");
  }
}

function bad(message: string): never {
  refuse("bad-header", message);
}

class Parser {
  private position = 0;

  constructor(private readonly text: string) {}

  whole(): JsonValue {
    const value = this.value(0);
    this.space();
    if (this.position < this.text.length) bad("the header goes on after its object");
    return value;
  }

  private value(depth: number): JsonValue {
    this.space();
    const first = this.text[this.position];
    if (first === "{" || first === "[") {
      if (depth === MAX_HEADER_NESTING) bad(`the header is nested more than ${MAX_HEADER_NESTING} deep`);
      this.position++;
      return first === "{" ? this.object(depth + 1) : this.list(depth + 1);
    }
    if (first === '"') return this.string();
    if (this.accept("null")) return null;
    if (this.accept("true")) return true;
    if (this.accept("false")) return false;
    return this.number();
  }

  private object(depth: number): JsonObject {
    const members: JsonObject = new Map();
    if (this.closes("}")) return members;
    do {
      this.space();
      const name = this.string();
      if (members.has(name)) bad(`the header has a name twice: ${JSON.stringify(name)}`);
      this.space();
      this.expect(":");
      members.set(name, this.value(depth));
    } while (this.goesOn("}"));
    return members;
  }

  private list(depth: number): JsonValue[] {
    const items: JsonValue[] = [];
    if (this.closes("]")) return items;
    do items.push(this.value(depth));
    while (this.goesOn("]"));
    return items;
  }

  private closes(bracket: string): boolean {
    this.space();
    return this.accept(bracket);
  }

  /** Whether a comma follows rather than the closing bracket. */
  private goesOn(bracket: string): boolean {
    this.space();
    if (this.accept(bracket)) return false;
    this.expect(",");
    return true;
  }

  private string(): string {
    this.expect('"');
    let text = "";
    for (;;) {
      text += this.match(PLAIN)![0];
      if (this.accept('"')) break;
      this.expect("\\");
      text += this.escape();
    }
    if (HALF_PAIR.test(text)) bad("the header has half of a surrogate pair");
    return text;
  }

  private escape(): string {
    const letter = this.text[this.position++] as string | undefined;
    if (letter === "u") {
      const digits = this.text.slice(this.position, this.position + 4);
      if (!/^[0-9a-fA-F]{4}$/.test(digits)) bad("the header has a broken escape");
      this.position += 4;
      return String.fromCharCode(parseInt(digits, 16));
    }
    if (letter === undefined || !Object.hasOwn(ESCAPES, letter)) bad("the header has a broken escape");
    return ESCAPES[letter];
  }

  private number(): JsonNumber {
    const match = this.match(NUMBER) ?? bad(`the header is no JSON at character ${this.position}`);
    const value = Number(match[0]);
    if (!Number.isFinite(value)) bad("the header has a number that is not finite");
    return new JsonNumber(value, /^-?[0-9]+$/.test(match[0]));
  }

  private match(pattern: RegExp): RegExpExecArray | null {
    pattern.lastIndex = this.position;
    const match = pattern.exec(this.text);
    if (match) this.position = pattern.lastIndex;
    return match;
  }

  private accept(word: string): boolean {
    if (!this.text.startsWith(word, this.position)) return false;
    this.position += word.length;
    return true;
  }

  private expect(word: string): void {
    if (!this.accept(word)) bad(`the header is no JSON at character ${this.position}: ${word} is missing`);
  }

  private space(): void {
    this.match(SPACE);
  }
}
