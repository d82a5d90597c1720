// Shows pictures of the camera to zoom and to pan, with what was found in them.
"use strict";
(() => {
  // Factor of a step of zoom, and largest number of screen px per image px.
  const STEP = 1.25, LARGEST = 64;
  // Widths of cut-outs, screen px, and distance of a click that is no drag, px.
  const CUT_OUT = 116, DRAG = 4;
  const WARN = "#ffb000", BOARD = "#ffd200";

  const make = (tag, properties = {}, ...children) => {
    const element = Object.assign(document.createElement(tag), properties);
    element.append(...children);
    return element;
  };

  // Unpacks columns of whole numbers: see `packed` in pictures.rs.
  const unpacked = async text => {
    const bytes = Uint8Array.from(atob(text), c => c.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate-raw"));
    const columns = await new Response(stream).json();
    return columns.map(column => {
      let sum = 0;
      return column.map(difference => (difference === null ? null : (sum += difference)));
    });
  };

  const scaled = (value, factor) => (value === null ? null : value / factor);
  const features = async text => {
    const [corner = [], k, l, u, v, rho, ...rest] = await unpacked(text);
    const [su, sv, srho, du, dv, drho] = rest;
    return corner.map((c, i) => ({
      corner: c, k: k[i], l: l[i], u: u[i] / 100, v: v[i] / 100, rho: scaled(rho[i], 100),
      su: scaled(su[i], 1000), sv: scaled(sv[i], 1000), srho: scaled(srho[i], 1000),
      du: scaled(du[i], 1000), dv: scaled(dv[i], 1000), drho: scaled(drho[i], 1000),
    }));
  };
  const microImages = async text => {
    const [k, l, u, v, type] = await unpacked(text);
    return k.map((_, i) => ({ k: k[i], l: l[i], u: u[i] / 100, v: v[i] / 100, type: type[i] }));
  };

  const hue = corner => `hsl(${(corner * 137) % 360} 90% 60%)`;
  const rmsOf = list => {
    const known = list.filter(f => f.du !== null);
    const sum = known.reduce((sum, f) => sum + f.du ** 2 + f.dv ** 2, 0);
    return known.length ? Math.sqrt(sum / known.length) : null;
  };
  const fixed = (value, digits) => value.toFixed(digits).replace("-", "−");

  function circle(context, u, v, radius) {
    context.moveTo(u + radius, v);
    context.arc(u, v, radius, 0, 2 * Math.PI);
  }

  // An arrow whose head is `head` long.
  function arrow(context, u, v, along, across, head) {
    const length = Math.hypot(along, across);
    if (length === 0) return;
    const [x, y] = [along / length, across / length].map(part => part * Math.min(head, length / 2));
    context.moveTo(u, v);
    context.lineTo(u + along, v + across);
    context.lineTo(u + along - x - y / 2, v + across - y + x / 2);
    context.moveTo(u + along, v + across);
    context.lineTo(u + along - x + y / 2, v + across - y - x / 2);
  }

  // Draws a feature and its residual; `px` is the size of a screen px.
  function drawFeature(context, f, enlarged, px) {
    context.lineWidth = 1.4 * px;
    context.strokeStyle = hue(f.corner);
    context.beginPath();
    circle(context, f.u, f.v, Math.max(Math.abs(f.rho ?? 0), 0.3));
    context.stroke();
    if (enlarged > 0 && f.du !== null) {
      context.beginPath();
      arrow(context, f.u, f.v, f.du * enlarged, f.dv * enlarged, 7 * px);
      context.strokeStyle = "#000";
      context.lineWidth = 3 * px;
      context.stroke();
      context.strokeStyle = "#fff";
      context.lineWidth = 1.4 * px;
      context.stroke();
    }
  }

  async function show(container) {
    const data = JSON.parse(container.querySelector("script").textContent);
    const centers = await microImages(data.centers);
    const ofPlace = new Map(centers.map(c => [`${c.k},${c.l}`, c]));
    const id = "picture";
    const choice = make("select", { id: `${id}-choice` });
    const corners = make("select", { id: `${id}-corner` });
    const checks = ["Micro-images", "Features", "Board"].map(name =>
      make("input", { type: "checkbox", checked: true, name }));
    const slider = make("input", {
      type: "range", id: `${id}-residuals`, min: 0, max: 40, value: 20, className: "slider",
    });
    const factor = make("output", { htmlFor: slider.id });
    const canvas = make("canvas", { tabIndex: 0, className: "picture" });
    canvas.setAttribute("role", "application");
    canvas.setAttribute("aria-roledescription", "picture to zoom");
    const status = make("p", { className: "status" });
    status.setAttribute("role", "status");
    const findings = make("ul", { className: "findings" });
    const panel = make("section", { className: "micro-images", hidden: true, tabIndex: -1 });
    const buttons = [["−", "Zoom out"], ["+", "Zoom in"], ["Fit", "Show all"]].map(([text, label]) => {
      const button = make("button", { type: "button" }, text);
      button.setAttribute("aria-label", label);
      return button;
    });
    const hint = "Drag or use the arrow keys to move; use the wheel, after a click into the picture, or + and − to zoom, " +
      "0 to show all. A click on a feature, or Enter for the one nearest to the middle, shows all micro-images of its corner.";
    canvas.setAttribute("aria-label", hint);
    container.append(
      make("div", { className: "tools" },
        make("label", {}, "Picture ", choice), make("span", {}, ...buttons),
        ...checks.map(check => make("label", {}, check, ` ${check.name}`)),
        make("label", {}, "Residuals ", slider, " ", factor), make("label", {}, "Corner ", corners)),
      canvas, status, panel, findings, make("p", { className: "hint" }, hint));

    let picture, found = [], small, full, fullState, view, chosen = null;
    const context = canvas.getContext("2d");
    const enlarged = () => (+slider.value === 0 ? 0 : 10 ** (slider.value / 10));

    const groups = new Map();
    data.pictures.forEach((p, i) => {
      if (!groups.has(p.group)) groups.set(p.group, choice.appendChild(make("optgroup", { label: p.group })));
      const rms = p.rms_px === null ? "" : ` · ${p.rms_px.toFixed(3)} px RMS`;
      const count = p.findings.length ? ` · ${p.findings.length} finding(s)` : "";
      groups.get(p.group).append(make("option", { value: i }, p.name + rms + count));
    });

    const size = () => [canvas.clientWidth, canvas.clientHeight];
    const fitted = () => Math.min(size()[0] / picture.size[0], size()[1] / picture.size[1]);
    function fit() {
      const scale = fitted(), [width, height] = size();
      view = { scale, u: (picture.size[0] - width / scale) / 2 - 0.5, v: (picture.size[1] - height / scale) / 2 - 0.5 };
      draw();
    }
    function zoom(by, x = size()[0] / 2, y = size()[1] / 2) {
      const scale = Math.min(Math.max(view.scale * by, fitted() / 2), LARGEST);
      view.u += x / view.scale - x / scale;
      view.v += y / view.scale - y / scale;
      view.scale = scale;
      draw();
    }
    function pan(x, y) {
      view.u += x / view.scale;
      view.v += y / view.scale;
      draw();
    }
    function look(u, v, scale) {
      view = { scale, u: u - size()[0] / scale / 2, v: v - size()[1] / scale / 2 };
      draw();
    }

    // The image itself is loaded when the small picture is shown enlarged.
    function load() {
      if (fullState !== "none" || !picture.image || view.scale * devicePixelRatio < small.naturalWidth / picture.size[0]) return;
      fullState = "loading";
      const of = picture, image = new Image();
      image.onload = () => { if (picture === of) { full = image; fullState = "loaded"; draw(); refresh(); } };
      image.onerror = () => { if (picture === of) { fullState = "missing"; say(); } };
      image.src = picture.image;
    }
    function say() {
      const [width, height] = picture.size;
      const copy = !picture.image ? "a reduced copy, since a browser cannot show the image itself"
        : fullState === "missing" ? `a reduced copy, since ${decodeURI(picture.image)} is missing`
          : fullState === "loaded" ? "the image itself" : "a reduced copy";
      const zoomed = view.scale < 1 ? `1 : ${(1 / view.scale).toFixed(1)}` : `${view.scale.toFixed(1)} : 1`;
      status.textContent = `${width} × ${height} px, ${found.length} features; shown ${zoomed}, ${copy}.`;
    }

    function paint(target, of) {
      const image = full ?? small;
      target.imageSmoothingEnabled = of < 2;
      target.filter = full && picture.gain > 1.05 ? `brightness(${picture.gain})` : "none";
      target.drawImage(image, -0.5, -0.5, picture.size[0], picture.size[1]);
      target.filter = "none";
    }
    function draw() {
      if (!picture || !canvas.clientWidth) return;
      const [width, height] = size(), ratio = devicePixelRatio || 1;
      if (canvas.width !== Math.round(width * ratio)) canvas.width = Math.round(width * ratio);
      if (canvas.height !== Math.round(height * ratio)) canvas.height = Math.round(height * ratio);
      const { scale, u, v } = view, px = 1 / scale;
      context.setTransform(1, 0, 0, 1, 0, 0);
      context.clearRect(0, 0, canvas.width, canvas.height);
      context.setTransform(scale * ratio, 0, 0, scale * ratio, -u * scale * ratio, -v * scale * ratio);
      paint(context, scale * ratio);
      const near = data.pitch_px + Math.abs(enlarged());
      const inside = p => p.u > u - near && p.v > v - near && p.u < u + width * px + near && p.v < v + height * px + near;
      const [microImages, ofFeatures, ofBoard] = checks.map(check => check.checked);
      // Circles smaller than this would hide the picture.
      if (microImages && data.pitch_px * scale > 20) {
        context.lineWidth = px;
        picture.radii_px.forEach((radius, type) => {
          context.beginPath();
          for (const c of centers) if (c.type === type && inside(c)) circle(context, c.u, c.v, radius);
          context.strokeStyle = data.colors[type];
          context.stroke();
        });
      }
      if (ofBoard) {
        context.beginPath();
        for (const line of picture.board) line.forEach(([x, y], i) => (i ? context.lineTo(x, y) : context.moveTo(x, y)));
        context.strokeStyle = BOARD;
        context.lineWidth = px;
        context.stroke();
        if (picture.board.length) {
          context.beginPath();
          circle(context, ...picture.board[0][0], 4 * px);
          context.fillStyle = BOARD;
          context.fill();
        }
      }
      if (ofFeatures) for (const f of found) if (inside(f)) drawFeature(context, f, enlarged(), f.corner === chosen ? 2 * px : px);
      picture.findings.forEach((finding, i) => {
        if (!finding.at) return;
        const [x, y] = finding.at;
        context.beginPath();
        circle(context, x, y, 11 * px);
        context.strokeStyle = WARN;
        context.lineWidth = 3 * px;
        context.stroke();
        context.font = `bold ${14 * px}px sans-serif`;
        context.fillStyle = WARN;
        context.fillText(i + 1, x + 13 * px, y - 7 * px);
      });
      load();
      say();
    }

    // Shows all micro-images of a corner side by side.
    function open(corner, focus) {
      chosen = corner;
      corners.value = corner;
      const list = found.filter(f => f.corner === corner);
      const close = make("button", { type: "button" }, "Close");
      close.onclick = shut;
      const rms = rmsOf(list);
      const [column, row] = [corner % picture.columns, Math.floor(corner / picture.columns)];
      const title = `Corner ${corner} (column ${column}, row ${row}): ${list.length} micro-images` +
        (rms === null ? "" : `, ${rms.toFixed(3)} px RMS`);
      const views = list.map(cutOut);
      panel.replaceChildren(make("h4", {}, title, " ", close),
        make("p", { className: "hint" }, "In px: the feature ± σ and, in brackets, its residual, observed minus projected."), make("div", { className: "cut-outs" }, ...views));
      panel.setAttribute("aria-label", title);
      panel.hidden = false;
      if (focus) panel.focus();
      draw();
    }
    function shut() {
      chosen = null;
      corners.value = "";
      panel.hidden = true;
      canvas.focus();
      draw();
    }
    function cutOut(f) {
      const ratio = devicePixelRatio || 1;
      const cut = make("canvas", { width: CUT_OUT * ratio, height: CUT_OUT * ratio });
      const center = ofPlace.get(`${f.k},${f.l}`) ?? f;
      const scale = CUT_OUT / (1.1 * data.pitch_px), side = CUT_OUT / scale;
      const target = cut.getContext("2d");
      target.setTransform(scale * ratio, 0, 0, scale * ratio, (side / 2 - center.u) * scale * ratio, (side / 2 - center.v) * scale * ratio);
      paint(target, scale);
      const radius = picture.radii_px[center.type];
      if (radius) {
        target.beginPath();
        circle(target, center.u, center.v, radius);
        target.strokeStyle = data.colors[center.type];
        target.lineWidth = 1 / scale;
        target.stroke();
      }
      drawFeature(target, f, enlarged(), 1 / scale);
      const line = (name, value, sigma, residual) => {
        if (value === null) return `${name} not measured`;
        const deviation = sigma === null ? "" : ` ± ${fixed(sigma, 3)}`;
        const rest = residual === null ? "" : ` (${residual < 0 ? "" : "+"}${fixed(residual, 3)})`;
        return `${name} ${fixed(value, 2)}${deviation}${rest}`;
      };
      const type = center.type === undefined ? "" : `, type ${center.type + 1}`;
      const words = [`(${f.k}, ${f.l})${type}`, line("u", f.u, f.su, f.du), line("v", f.v, f.sv, f.dv), line("ρ", f.rho, f.srho, f.drho)];
      cut.setAttribute("role", "img");
      cut.setAttribute("aria-label", `Micro-image ${words[0]}`);
      return make("figure", {}, cut, make("figcaption", {}, words.join("\n")));
    }
    // Draws the open cut-outs again, from the image itself or with other arrows.
    function refresh() {
      if (chosen !== null) open(chosen, false);
    }

    function nearest(x, y, within) {
      const [u, v] = [view.u + x / view.scale, view.v + y / view.scale];
      let best = null, least = within / view.scale;
      for (const f of found) {
        const off = Math.max(Math.hypot(f.u - u, f.v - v) - Math.abs(f.rho ?? 0), 0) + 1e-3 * Math.hypot(f.u - u, f.v - v);
        if (off < least) [best, least] = [f, off];
      }
      return best;
    }

    async function choose(i) {
      picture = data.pictures[i];
      [full, fullState, found, chosen] = [null, "none", [], null];
      panel.hidden = true;
      const of = picture, image = new Image();
      image.src = `data:image/jpeg;base64,${picture.jpeg}`;
      const [list] = await Promise.all([features(picture.features), image.decode()]);
      if (picture !== of) return;
      [found, small] = [list, image];
      corners.replaceChildren(make("option", { value: "" }, found.length ? "choose" : "none"));
      for (const corner of new Set(found.map(f => f.corner))) {
        const own = found.filter(f => f.corner === corner), rms = rmsOf(own);
        corners.append(make("option", { value: corner }, `${corner} · ${own.length} micro-images` + (rms === null ? "" : ` · ${rms.toFixed(3)} px RMS`)));
      }
      findings.replaceChildren(...picture.findings.map(finding => {
        if (!finding.at) return make("li", {}, finding.text);
        const button = make("button", { type: "button" }, finding.text);
        button.onclick = () => {
          look(...finding.at, 8);
          if (finding.corner !== null) open(finding.corner, false);
        };
        return make("li", {}, button);
      }));
      canvas.dataset.picture = picture.name;
      fit();
    }

    choice.onchange = () => choose(choice.value);
    corners.onchange = () => {
      if (corners.value === "") return shut();
      const f = found.find(f => f.corner === +corners.value);
      look(f.u, f.v, Math.max(view.scale, 4));
      open(f.corner, false);
    };
    checks.forEach(check => (check.onchange = draw));
    slider.oninput = () => {
      factor.textContent = enlarged() ? `× ${Math.round(enlarged())}` : "hidden";
      draw();
      refresh();
    };
    buttons[0].onclick = () => zoom(1 / STEP ** 2);
    buttons[1].onclick = () => zoom(STEP ** 2);
    buttons[2].onclick = fit;
    canvas.onkeydown = event => {
      const [width, height] = size().map(edge => edge / 8);
      const actions = {
        ArrowLeft: () => pan(-width, 0), ArrowRight: () => pan(width, 0),
        ArrowUp: () => pan(0, -height), ArrowDown: () => pan(0, height),
        "+": () => zoom(STEP), "=": () => zoom(STEP), "-": () => zoom(1 / STEP), 0: fit,
        Enter: () => {
          const f = nearest(width * 4, height * 4, Infinity);
          if (f) open(f.corner, true);
        },
      };
      const action = event.ctrlKey || event.altKey || event.metaKey ? undefined : actions[event.key];
      if (!action) return;
      event.preventDefault();
      action();
    };
    panel.onkeydown = event => {
      if (event.key === "Escape") shut();
    };
    canvas.addEventListener("wheel", event => {
      // Otherwise the page would not scroll past the picture.
      if (document.activeElement !== canvas && !event.ctrlKey) return;
      event.preventDefault();
      zoom(STEP ** (-event.deltaY / 100), event.offsetX, event.offsetY);
    }, { passive: false });
    const pointers = new Map();
    let moved = 0;
    canvas.onpointerdown = event => {
      if (!pointers.size) moved = 0;
      pointers.set(event.pointerId, [event.offsetX, event.offsetY]);
      canvas.setPointerCapture(event.pointerId);
    };
    canvas.onpointermove = event => {
      const before = pointers.get(event.pointerId);
      if (!before) return;
      const now = [event.offsetX, event.offsetY], [x, y] = [now[0] - before[0], now[1] - before[1]];
      pointers.set(event.pointerId, now);
      moved += Math.hypot(x, y);
      const other = [...pointers].find(([pointer]) => pointer !== event.pointerId)?.[1];
      if (!other) return pan(-x, -y);
      const apart = point => Math.hypot(point[0] - other[0], point[1] - other[1]);
      zoom(apart(now) / Math.max(apart(before), 1), ...other);
    };
    canvas.onpointerup = event => pointers.delete(event.pointerId);
    canvas.onpointercancel = canvas.onpointerup;
    canvas.onclick = event => {
      if (moved > DRAG) return;
      const f = nearest(event.offsetX, event.offsetY, 8);
      if (f) open(f.corner, true);
    };
    new ResizeObserver(() => {
      if (!small) return;
      draw();
    }).observe(canvas);
    factor.textContent = `× ${Math.round(enlarged())}`;
    // The picture with most findings comes first.
    const counts = data.pictures.map(p => p.findings.length);
    choice.value = counts.indexOf(Math.max(...counts));
    await choose(choice.value);
  }

  for (const container of document.querySelectorAll(".pictures")) {
    show(container).catch(error => {
      container.append(make("p", {}, `The pictures cannot be shown: ${error.message}.`));
    });
  }
})();
