/** The picture that stands for a stream until somebody plays it, seeks in it or looks elsewhere, as that of <video>. */
export class Poster {
  readonly image = document.createElement("img");
  #given = false;
  /** Whether it stands for the stream still. */
  #stands = true;
  /** Whether there is another picture to be seen. */
  #drawn = false;

  constructor() {
    this.image.className = "poster";
    this.image.alt = "";
    this.image.hidden = true;
    this.image.addEventListener("error", () => {
      this.#show(false);
    });
  }

  /** Empty: there is none. */
  set address(address: string) {
    if (address !== "") this.image.src = address;
    this.#show(address !== "");
  }

  /** Another stream is opened. */
  stand(): void {
    this.#stands = true;
    this.#drawn = false;
    this.#show(this.#given);
  }

  /** Somebody wants to see the stream: its picture takes the poster's place, as soon as it is there. */
  giveWay(): void {
    this.#stands = false;
    this.#show(this.#given);
  }

  /** A picture of the stream was drawn. */
  drawn(): void {
    if (this.#drawn) return;
    this.#drawn = true;
    this.#show(this.#given);
  }

  #show(given: boolean): void {
    this.#given = given;
    this.image.hidden = !given || (this.#drawn && !this.#stands);
  }
}
