// @ts-check
/** Saving the scene: in its own file, or in a new one. */

export class Save {
  /**
   * @param {HTMLButtonElement} button @param {HTMLButtonElement} another saves in a new file
   * @param {(request: object) => Promise<any>} ask sends a request, and shows why it was refused
   * @param {() => string[]} unsaved names of the parameters that differ from the file
   */
  constructor(button, another, ask, unsaved) {
    this.button = button;
    this.another = another;
    this.ask = ask;
    this.unsaved = unsaved;
    /** @type {string | null} */
    this.file = null; // the scene's own
    this.title = "";
    button.onclick = () => this.save(this.file === null);
    another.onclick = () => this.save(true);
  }

  /** @param {any} model */
  describe(model) {
    [this.file, this.title] = [model.file, model.title.replaceAll(" ", "_")];
    this.button.hidden = !model.can_save;
    this.another.hidden = !model.can_save || this.file === null; // then the button asks for a name anyway
    this.draw();
  }

  /** @param {boolean} asksName */
  async save(asksName) {
    const name = asksName ? prompt("Name of the new file", `${this.title}.yaml`) : null;
    if (asksName && !name) return;
    this.button.disabled = true;
    await this.ask({ type: "save", as: name });
    this.button.disabled = false;
  }

  /** Says how many values differ, and where they are saved. */
  draw() {
    const names = this.unsaved();
    this.button.textContent = names.length ? `Save ${names.length}` : "Save";
    this.button.title = `${this.file ?? "a new file"}: ${names.join(", ") || "nothing differs"}`;
  }
}
