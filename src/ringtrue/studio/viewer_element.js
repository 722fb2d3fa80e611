// The 3D viewer as a component: arrays come as blocks of bytes over HTTP, what is shown as properties.
import { Clock, figure, mount, unpack } from "ringtrue-viewer";

const block = async (address) => {
  const answer = await fetch(address, { credentials: "same-origin" });
  if (answer.status !== 200) throw new Error(`${address}: ${answer.status} ${answer.statusText}`);
  return unpack(await answer.arrayBuffer());
};

const style = () => {
  if (document.getElementById("ringtrue-viewer-style")) return;
  const link = document.createElement("link");
  Object.assign(link, { id: "ringtrue-viewer-style", rel: "stylesheet", href: new URL("viewer.css", import.meta.resolve("ringtrue-viewer")) });
  document.head.append(link);
};

const groups = new Map(); // name: {clock, views} of views that move and turn together
const groupOf = (name) => {
  if (!groups.has(name)) groups.set(name, { clock: new Clock(), views: new Set() });
  return groups.get(name);
};

export default {
  template: "<div><div></div></div>",
  props: { drawn: String, whole: Boolean, options: Object, linked: String, modelShapes: Object, testShapes: Object, fields: Object, sensors: String, state: Object, playing: Boolean, aim: Object },
  mounted() {
    style();
    this.known = { state: {} };
    this.work = this.begin();
    for (const name of ["modelShapes", "testShapes", "fields", "sensors", "state", "playing", "aim"]) this.$watch(name, () => this.later());
    this.later();
  },
  unmounted() {
    this.gone = true;
    if (this.group) this.group.views.delete(this.view);
    if (this.view) this.view.destroy();
  },
  methods: {
    async begin() {
      const [drawn, group] = [await block(this.drawn), this.linked ? groupOf(this.linked) : { clock: new Clock(), views: new Set() }];
      if (this.gone) return;
      const options = { wheel: "always", ...this.options, clock: group.clock };
      const element = this.$el.firstChild;
      if (!this.whole) element.classList.add("filling");
      this.view = this.whole ? figure(element, drawn, options).view : mount(element, drawn, options);
      this.group = group;
      group.views.add(this.view);
      for (const name of ["pick", "menu", "hover", "box", "drag"]) this.view.on(name, (found) => this.$emit(`view-${name}`, found));
      this.view.on("camera", (camera) => {
        for (const other of group.views) if (other !== this.view) other.show({ camera });
        this.$emit("view-camera", camera);
      });
      this.$el.ringtrueView = this.view;
    },
    // One change after the other: what is shown needs what is fetched before.
    // What was replaced before it was fetched is gone: the change that replaced it follows.
    later() { this.work = this.work.then(() => this.gone || this.apply()).catch((error) => console.warn(error)); },
    async apply() {
      const { view, known } = this, change = {};
      for (const [name, value] of Object.entries(this.state)) {
        if (JSON.stringify(value) !== JSON.stringify(known.state[name])) change[name] = value;
      }
      await this.fetched(change);
      if (this.gone) return;
      known.state = { ...known.state, ...change };
      if (Object.keys(change).length) view.show(change);
      if (known.playing !== this.playing && (known.playing !== undefined || this.playing)) {
        // what else is on the page comes before the first motion
        if (this.playing && known.playing === undefined) (window.requestIdleCallback || setTimeout)(() => this.playing && !this.gone && view.play());
        else if (this.playing) view.play();
        else view.pause();
      }
      known.playing = this.playing;
      if (this.aim && this.aim.count !== known.aim) {
        known.aim = this.aim.count;
        view.fly(this.aim.selection);
      }
    },
    // Shapes and fields that are named for the first time, or anew.
    async fetched(change) {
      const { view, known, state } = this, of = { mode: this.modelShapes, test: this.testShapes, field: this.fields };
      if (this.sensors && this.sensors !== known.sensors) {
        known.sensors = this.sensors;
        view.sensors(await block(this.sensors));
      }
      for (const key of ["mode", "test", "field"]) {
        const name = state[key], kept = of[key], address = name && kept[name] && kept[name].address;
        if (!address || known[`${key} ${name}`] === address) continue;
        known[`${key} ${name}`] = address;
        const found = await block(address);
        if (key === "field") view.field(name, { ...found, ...kept[name].look });
        else view.shapes(name, found, key === "mode" ? "model" : "test");
        change[key] = name;
      }
    },
  },
};
