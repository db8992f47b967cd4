// A humanoid under its learned policy, in MuJoCo's WebAssembly build: the model, what the policy
// observes (silem/envs/mujoco.py), what it does (a tanh MLP), and the control step.
window.silem = window.silem || {};
silem.body = {};

const ARM_LINKS = ["upper_arm", "lower_arm", "hand"];

/** Start MuJoCo once; a promise of its module. */
silem.body.engine = () => {
  silem.body.started ??= (async () => {
    const [program, binary] = await Promise.all(["mujoco.js", "mujoco.wasm"].map(silem.bytes));
    const url = URL.createObjectURL(new Blob([program], { type: "text/javascript" }));
    const { default: load } = await import(url);
    URL.revokeObjectURL(url);
    // the name is never loaded from: the binary is here
    return load({ wasmBinary: binary, locateFile: (name) => name });
  })();
  return silem.body.started;
};

/** A body's pack: its header, and the policy's numbers. */
silem.body.read = (bytes) => {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const size = view.getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(bytes.subarray(4, 4 + size)));
  const values = new Float32Array((bytes.byteLength - 4 - size) / 4);
  values.forEach((_, i) => (values[i] = view.getFloat32(4 + size + 4 * i, true)));
  let start = 0;
  const next = (count) => values.subarray(start, (start += count));
  const [n, last] = [header.layers[0][1], header.layers.at(-1)[0]];
  const policy = { clip: header.clip, mean: next(n), scale: next(n) };
  policy.layers = header.layers.map(([out, from]) => ({
    weight: next(out * from),
    bias: next(out),
  }));
  policy.std = Array.from(next(last), Math.exp);
  if (start !== values.length) throw new Error("the policy's file has a wrong length");
  return { header, policy };
};

/** The mean action (A,) of a policy for an observation (O,). */
silem.body.act = (policy, observation) => {
  const { mean, scale, clip, layers } = policy;
  let x = Array.from(observation, (value, i) =>
    Math.max(-clip, Math.min(clip, Math.fround(Math.fround(value) - mean[i]) / scale[i])),
  );
  layers.forEach(({ weight, bias }, index) => {
    const size = x.length;
    x = Array.from(bias, (sum, row) => {
      for (let i = 0; i < size; i++) sum += weight[row * size + i] * x[i];
      return index < layers.length - 1 ? Math.tanh(sum) : sum;
    });
  });
  return x;
};

/** The model's text with its arms scaled from the shoulder on, as silem.bodies.humanoid does. */
silem.body.scaled = (text, arms) => {
  const xml = new DOMParser().parseFromString(text, "text/xml");
  const scale = (element, name, factor) => {
    const values = element.getAttribute(name).trim().split(/\s+/);
    element.setAttribute(name, values.map((value) => Number(value) * factor).join(" "));
  };
  for (const [side, factor] of Object.entries(arms))
    for (const name of ARM_LINKS) {
      const link = xml.querySelector(`body[name="${side}_${name}"]`);
      for (const child of link.children)
        if (child.tagName === "geom" && child.hasAttribute("fromto")) scale(child, "fromto", factor);
      if (name !== "upper_arm") scale(link, "pos", factor); // whose place is the shoulder
    }
  return new XMLSerializer().serializeToString(xml);
};

/** One humanoid: its state, stepped, read and pushed. */
silem.body.Simulation = class {
  constructor(mujoco, header, arms = header.arms) {
    Object.assign(this, { mujoco, header });
    this.build(arms);
    this.reset();
  }

  /** Compile the model with these arm factors; the state is kept if there is one. */
  build(arms) {
    const { mujoco, header } = this;
    const state = this.data && { qpos: this.data.qpos.slice(), qvel: this.data.qvel.slice() };
    const model = mujoco.MjModel.from_xml_string(silem.body.scaled(header.model, arms));
    this.data?.delete();
    this.model?.delete();
    Object.assign(this, { model, arms: { ...arms }, data: new mujoco.MjData(model) });
    const id = (point) => mujoco.mj_name2id(model, 1, header.skeleton[point]);
    const points = Object.keys(header.skeleton).filter((point) => point !== "axes");
    this.ids = Object.fromEntries(points.map((point) => [point, id(point)]));
    this.root = model.body_rootid[this.ids.torso];
    this.axes = Array.from(header.skeleton.axes, (axis) => "xyz".indexOf(axis));
    this.pushes = [];
    if (state) this.place(state.qpos, state.qvel);
  }

  /** Put the body into a state; the pose that stands, at rest, without one. */
  place(qpos = this.header.standing_pose, qvel = null) {
    const { mujoco, model, data } = this;
    mujoco.mj_resetData(model, data);
    data.qpos.set(qpos);
    if (qvel) data.qvel.set(qvel);
    mujoco.mj_forward(model, data);
  }

  reset() {
    this.place();
    Object.assign(this, { steps: 0, fallen: false, pushes: [], start: this.point("torso") });
  }

  get seconds() {
    return (this.steps * this.model.opt.timestep) || 0;
  }

  point(name) {
    return Array.from(this.data.xpos.subarray(3 * this.ids[name], 3 * this.ids[name] + 3));
  }

  /** Forward, left and up of the torso in the world. */
  torsoAxes() {
    const frame = this.data.xmat.subarray(9 * this.ids.torso, 9 * this.ids.torso + 9);
    return this.axes.map((axis) => [frame[axis], frame[3 + axis], frame[6 + axis]]);
  }

  velocity() {
    this.mujoco.mj_subtreeVel(this.model, this.data);
    return Array.from(this.data.subtree_linvel.subarray(3 * this.root, 3 * this.root + 3));
  }

  /** What the policy sees (O,): dm_control's observation. */
  observe() {
    const axes = this.torsoAxes();
    const torso = this.point("torso");
    const relative = (name) => {
      const way = this.point(name).map((value, i) => value - torso[i]);
      return axes.map((axis) => axis.reduce((sum, value, i) => sum + value * way[i], 0));
    };
    return Float32Array.from([
      ...this.data.qpos.subarray(7),
      this.point("head")[2],
      ...["left_hand", "left_foot", "right_hand", "right_foot"].flatMap(relative),
      ...axes.map((axis) => axis[2]),
      ...this.velocity(),
      ...this.data.qvel,
    ]);
  }

  /** Push the torso with a force [x, y, 0] in N, for some seconds. */
  push(force, seconds = 0.2) {
    const end = this.steps + Math.round(seconds / this.model.opt.timestep);
    this.pushes.push({ force, end });
  }

  /** The force on the torso now. */
  get force() {
    this.pushes = this.pushes.filter(({ end }) => end > this.steps);
    return this.pushes.reduce((sum, { force }) => sum.map((v, i) => v + force[i]), [0, 0, 0]);
  }

  /** One substep; `act` gives the actions when a control step begins. A fallen body is limp. */
  step(act) {
    const { mujoco, model, data, header } = this;
    if (this.steps % header.n_substeps === 0 && !this.fallen) {
      data.ctrl.set(act(this.observe()).map((value) => Math.max(-1, Math.min(1, value))));
    } else if (this.fallen) data.ctrl.fill(0);
    data.xfrc_applied.set(this.force, 6 * this.ids.torso);
    // MuJoCo's step is the first half and the second; dm_control's control step begins at the
    // second, so that positions and velocities are up to date between steps.
    mujoco.mj_step2(model, data);
    mujoco.mj_step1(model, data);
    this.steps += 1;
    const head = this.point("head")[2];
    this.fallen ||= !(head >= header.fall_head_m);
    if (!Number.isFinite(head)) this.place();
  }
};
