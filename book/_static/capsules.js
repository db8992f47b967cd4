// A small WebGL view of capsules and spheres on a floor, in the colours of the page's theme.
window.silem = window.silem || {};

(() => {
  const VERTEX = `#version 300 es
  // A unit sphere cut in two: side says which end of the capsule a vertex belongs to.
  layout(location = 0) in vec3 normal;
  layout(location = 1) in float side;
  uniform mat4 projection;
  uniform mat3 frame;
  uniform vec3 centre, light;
  uniform vec2 radii; // of both ends
  uniform float halfLength;
  uniform bool shadow;
  out vec3 outward, place;
  void main() {
    float radius = side > 0.0 ? radii.y : radii.x;
    outward = frame * normal;
    place = centre + frame * (normal * radius + vec3(0.0, 0.0, side * halfLength));
    if (shadow) place -= light * ((place.z - 0.004) / light.z);
    gl_Position = projection * vec4(place, 1.0);
  }`;
  const FRAGMENT = `#version 300 es
  precision highp float;
  in vec3 outward, place;
  uniform vec3 colour, light, eye;
  uniform bool shadow;
  uniform vec4 shade;
  out vec4 drawn;
  void main() {
    if (shadow) { drawn = shade; return; }
    vec3 n = normalize(outward), view = normalize(eye - place);
    float lit = 0.52 + 0.14 * n.z + 0.38 * max(dot(n, light), 0.0);
    float gloss = pow(max(dot(n, normalize(light + view)), 0.0), 40.0);
    float rim = pow(1.0 - max(dot(n, view), 0.0), 3.0);
    drawn = vec4(colour * lit + 0.16 * gloss + 0.10 * rim, 1.0);
  }`;
  const FLOOR_VERTEX = `#version 300 es
  layout(location = 0) in vec2 corner;
  uniform mat4 projection;
  uniform vec3 eye;
  out vec2 place;
  void main() {
    place = eye.xy + corner * 40.0;
    gl_Position = projection * vec4(place, 0.0, 1.0);
  }`;
  const FLOOR_FRAGMENT = `#version 300 es
  precision highp float;
  in vec2 place;
  uniform vec3 ground, line, sky, focus;
  out vec4 drawn;
  void main() { // a line each metre, a stronger one every five, fading into the sky
    vec2 width = fwidth(place);
    vec2 near = abs(fract(place - 0.5) - 0.5) / width, far = abs(fract(place / 5.0 - 0.5) - 0.5) * 5.0 / width;
    float thin = 0.45 * (1.0 - min(min(near.x, near.y), 1.0)), thick = 1.0 - min(min(far.x, far.y) / 1.6, 1.0);
    float fade = smoothstep(4.0, 17.0, distance(place, focus.xy));
    drawn = vec4(mix(mix(ground, line, max(thin, thick) * (1.0 - max(width.x, width.y) * 0.8)), sky, fade), 1.0);
  }`;
  const LIGHT = unit([0.35, -0.45, 1]);

  function unit(v) {
    const length = Math.hypot(...v);
    return v.map((value) => value / length);
  }
  const cross = (a, b) => [0, 1, 2].map((i) => a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3]);
  const dot = (a, b) => a.reduce((sum, value, i) => sum + value * b[i], 0);

  /** A camera's matrix, by columns, that looks from `eye` at `focus`, z up. */
  function camera(eye, focus, degrees, aspect) {
    const back = unit(eye.map((value, i) => value - focus[i]));
    const right = unit(cross([0, 0, 1], back));
    const up = cross(back, right);
    const scale = 1 / Math.tan((degrees * Math.PI) / 360);
    const [near, far] = [0.1, 80];
    const rows = [
      [...right, -dot(right, eye)].map((value) => (value * scale) / aspect),
      [...up, -dot(up, eye)].map((value) => value * scale),
      [...back, -dot(back, eye)].map((value) => (value * (far + near)) / (near - far)),
      [...back, -dot(back, eye)].map((value) => -value),
    ];
    rows[2][3] += (2 * far * near) / (near - far);
    return { matrix: [0, 1, 2, 3].flatMap((c) => rows.map((row) => row[c])), right, back };
  }

  /** Vertices (normal, side) and triangles of a unit sphere that is cut at its equator. */
  function sphere(around = 28, down = 10) {
    const [vertices, triangles] = [[], []];
    for (const side of [-1, 1])
      for (let i = 0; i <= down; i++)
        for (let j = 0; j <= around; j++) {
          const [tilt, turn] = [((Math.PI / 2) * (side < 0 ? 1 + (down - i) / down : 1 - i / down)), (2 * Math.PI * j) / around];
          vertices.push(Math.sin(tilt) * Math.cos(turn), Math.sin(tilt) * Math.sin(turn), Math.cos(tilt), side);
        }
    const rows = 2 * (down + 1);
    for (let i = 0; i < rows - 1; i++)
      for (let j = 0; j < around; j++) {
        const a = i * (around + 1) + j;
        triangles.push(a, a + 1, a + around + 1, a + 1, a + around + 2, a + around + 1);
      }
    return { vertices: new Float32Array(vertices), triangles: new Uint16Array(triangles) };
  }

  /** The red, green and blue (0 to 1) of a colour as CSS writes it. */
  silem.rgb = (text) => {
    const canvas = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
    canvas.fillStyle = text;
    canvas.fillRect(0, 0, 1, 1);
    return Array.from(canvas.getImageData(0, 0, 1, 1).data.slice(0, 3), (value) => value / 255);
  };

  /** A view on a canvas. `draw` shows shapes { centre, frame (9, by rows), radii, halfLength, colour }. */
  silem.View = class {
    constructor(canvas) {
      const gl = canvas.getContext("webgl2", { antialias: true, stencil: true, alpha: false });
      if (!gl) throw new Error("this browser has no WebGL 2");
      Object.assign(this, { canvas, gl });
      const program = (vertex, fragment) => {
        const made = gl.createProgram();
        for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
          const shader = gl.createShader(kind);
          gl.shaderSource(shader, source);
          gl.compileShader(shader);
          if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
          gl.attachShader(made, shader);
        }
        gl.linkProgram(made);
        const at = new Proxy({}, { get: (known, name) => (known[name] ??= gl.getUniformLocation(made, name)) });
        return { program: made, at };
      };
      this.bodies = program(VERTEX, FRAGMENT);
      this.floor = program(FLOOR_VERTEX, FLOOR_FRAGMENT);
      const buffer = (kind, data) => {
        gl.bindBuffer(kind, gl.createBuffer());
        gl.bufferData(kind, data, gl.STATIC_DRAW);
      };
      const { vertices, triangles } = sphere();
      this.count = triangles.length;
      this.mesh = gl.createVertexArray();
      gl.bindVertexArray(this.mesh);
      buffer(gl.ARRAY_BUFFER, vertices);
      buffer(gl.ELEMENT_ARRAY_BUFFER, triangles);
      gl.enableVertexAttribArray(0);
      gl.enableVertexAttribArray(1);
      gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 16, 0);
      gl.vertexAttribPointer(1, 1, gl.FLOAT, false, 16, 12);
      this.quad = gl.createVertexArray();
      gl.bindVertexArray(this.quad);
      buffer(gl.ARRAY_BUFFER, new Float32Array([-1, -1, 1, -1, -1, 1, 1, 1]));
      gl.enableVertexAttribArray(0);
      gl.vertexAttribPointer(0, 2, gl.FLOAT, false, 8, 0);
    }

    /** Draw the shapes around `focus`, seen from `turn` radians around it. */
    draw(shapes, focus, turn, theme) {
      const { gl, canvas } = this;
      const ratio = Math.min(devicePixelRatio || 1, 2);
      const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((size) => Math.max(1, Math.round(size * ratio)));
      if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
      gl.viewport(0, 0, width, height);
      gl.clearColor(...theme.sky, 1);
      gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT | gl.STENCIL_BUFFER_BIT);
      const away = 4.3 * Math.max(1, (0.85 * height) / width); // a narrow picture from further away
      const eye = [focus[0] + away * Math.cos(turn), focus[1] + away * Math.sin(turn), focus[2] + 0.16 * away];
      const seen = camera(eye, focus, 32, width / height);
      Object.assign(this, { right: seen.right, back: seen.back });

      gl.enable(gl.DEPTH_TEST);
      gl.useProgram(this.floor.program);
      gl.bindVertexArray(this.quad);
      gl.uniformMatrix4fv(this.floor.at.projection, false, seen.matrix);
      for (const [name, value] of Object.entries({ eye, focus, ground: theme.ground, line: theme.line, sky: theme.sky }))
        gl.uniform3fv(this.floor.at[name], value);
      gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);

      const { at, program } = this.bodies;
      gl.useProgram(program);
      gl.bindVertexArray(this.mesh);
      gl.uniformMatrix4fv(at.projection, false, seen.matrix);
      gl.uniform3fv(at.light, LIGHT);
      gl.uniform3fv(at.eye, eye);
      gl.uniform4fv(at.shade, theme.shade);
      // the shadow darkens each pixel once
      gl.enable(gl.STENCIL_TEST);
      gl.enable(gl.BLEND);
      gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
      gl.stencilFunc(gl.EQUAL, 0, 255);
      gl.stencilOp(gl.KEEP, gl.KEEP, gl.INCR);
      this.shapes(shapes.filter((shape) => !shape.floats), true);
      gl.disable(gl.STENCIL_TEST);
      gl.disable(gl.BLEND);
      this.shapes(shapes, false);
    }

    shapes(shapes, shadow) {
      const { gl, bodies: { at } } = this;
      gl.uniform1i(at.shadow, shadow);
      for (const { centre, frame, radii, halfLength, colour } of shapes) {
        gl.uniformMatrix3fv(at.frame, true, frame);
        gl.uniform3fv(at.centre, centre);
        gl.uniform2fv(at.radii, radii);
        gl.uniform1f(at.halfLength, halfLength);
        gl.uniform3fv(at.colour, colour);
        gl.drawElements(gl.TRIANGLES, this.count, gl.UNSIGNED_SHORT, 0);
      }
    }
  };

  /** A shape between two points, of these radii at its ends. */
  silem.between = (from, to, radii, colour) => {
    const way = to.map((value, i) => value - from[i]);
    const along = unit(way);
    const side = unit(cross(along, Math.abs(along[2]) < 0.9 ? [0, 0, 1] : [1, 0, 0]));
    const third = cross(along, side);
    return {
      centre: from.map((value, i) => value + way[i] / 2),
      frame: [0, 1, 2].flatMap((i) => [side[i], third[i], along[i]]),
      radii, halfLength: Math.hypot(...way) / 2, colour, floats: true,
    };
  };

  /** The capsules and spheres of a model's data; `colour` names one by the body's number. */
  silem.shapesOf = (model, data, colour) => {
    const shapes = [];
    for (let i = 0; i < model.ngeom; i++) {
      const kind = model.geom_type[i];
      if (kind !== 2 && kind !== 3) continue; // sphere, capsule
      const [radius, half] = model.geom_size.subarray(3 * i, 3 * i + 2);
      shapes.push({
        centre: data.geom_xpos.slice(3 * i, 3 * i + 3),
        frame: data.geom_xmat.slice(9 * i, 9 * i + 9),
        radii: [radius, radius],
        halfLength: kind === 3 ? half : 0,
        colour: colour(model.geom_bodyid[i]),
      });
    }
    return shapes;
  };
})();
