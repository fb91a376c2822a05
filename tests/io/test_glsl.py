"""Shaders of fitted models, run by WebGL 2 in a browser without a window, against the library's own evaluation."""

import json
import re
import shutil
import subprocess

import jax.numpy as jnp
import numpy as np
import pytest

import hshjax
from hshjax import bases
from hshjax.io.glsl import glsl_source, write_glsl
from tests.helpers import DTYPE, X64, directions
from tests.io.renderers import linear, models

RESERVED = ("float", "vec3", "mat4x3", "usampler2DArray", "if", "precision", "true", "double", "union", "main", "max")
"""Of GLSL ES 3.00: types, keywords, words kept for later, what a shader or this function needs."""

MODELS = models() | {
    "hsh 12": linear(bases.IsotropicBasis(bases.HSH(12))),
    "fitted": hshjax.LogLinearBRDF(bases.HalfVectorBasis(3), [np.asarray([-1.0, -2.0, 0.5], DTYPE)] * 3),
}

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")

PAIRS = 256

PAGE = """<!doctype html><pre id="answer"></pre><script>
const shaders = SHADERS, pairs = PAIRS, count = COUNT;
function answer() {
  const gl = document.createElement("canvas").getContext("webgl2");
  if (!gl || !gl.getExtension("EXT_color_buffer_float")) return {missing: "WebGL 2 with EXT_color_buffer_float"};
  function texture(width, height, data) {
    const made = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, made);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, width, height, 0, gl.RGBA, gl.FLOAT, data);
    for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER])
      gl.texParameteri(gl.TEXTURE_2D, filter, gl.NEAREST);
    return made;
  }
  const image = texture(count, 1, null);
  const frame = gl.createFramebuffer();
  gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, image, 0);
  texture(count, 2, new Float32Array(pairs));
  gl.viewport(0, 0, count, 1);
  const values = {};
  for (const [name, source] of Object.entries(shaders)) {
    const program = gl.createProgram();
    const vertex = "#version 300 es\\nvoid main() { gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, " +
      "gl_VertexID == 2 ? 3.0 : -1.0, 0.0, 1.0); }";
    const fragment = "#version 300 es\\nprecision highp float; precision highp sampler2D;\\n" +
      "uniform sampler2D directions; out vec4 colour;\\n" + source +
      "\\nvoid main() { int k = int(gl_FragCoord.x); colour = vec4(hshjax_brdf(" +
      "texelFetch(directions, ivec2(k, 0), 0).xyz, texelFetch(directions, ivec2(k, 1), 0).xyz), 1.0); }";
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) return {error: name + ": " + gl.getShaderInfoLog(shader)};
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) return {error: name + ": " + gl.getProgramInfoLog(program)};
    gl.useProgram(program);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    const read = new Float32Array(4 * count);
    gl.readPixels(0, 0, count, 1, gl.RGBA, gl.FLOAT, read);
    if (gl.getError()) return {error: name + ": an error of WebGL"};
    values[name] = Array.from(read, x => Number.isFinite(x) ? x : String(x));
  }
  return {values};
}
document.getElementById("answer").textContent = JSON.stringify(answer());
</script>"""


def pairs():
    """Directions over the hemisphere, near grazing, mirrored, equal, at the pole, below the horizon."""
    wi, wo = (np.array(directions(k, PAIRS, min_z=0.02), np.float32) for k in (11, 12))
    wo[:16] = wi[:16] * (-1, -1, 1)
    wo[16:32] = wi[16:32]
    wi[32:40] = wo[40:48] = (0, 0, 1)
    wi[48:52, 2] *= -1
    wo[52:56, 2] *= -1
    return wi, wo


@pytest.fixture(scope="module")
def shown(tmp_path_factory):
    """What the browser says of every model, `(pairs, 3)`, clamped and not."""
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        pytest.skip(f"a browser: none of {', '.join(BROWSERS)} found")
    sources = {name: glsl_source(model) for name, model in MODELS.items()}
    sources |= {f"{name}, signed": glsl_source(model, clamp=False) for name, model in MODELS.items()}
    sent = np.concatenate([np.concatenate([w, np.zeros((PAIRS, 1), np.float32)], 1) for w in pairs()])
    folder = tmp_path_factory.mktemp("browser")
    page = PAGE.replace("SHADERS", json.dumps(sources)).replace("COUNT", str(PAIRS))
    (folder / "page.html").write_text(page.replace("PAIRS", json.dumps(sent.ravel().tolist())), encoding="utf-8")
    done = subprocess.run(
        [
            browser, "--headless=new", "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader",
            "--enable-unsafe-swiftshader", f"--user-data-dir={folder}", "--dump-dom", (folder / "page.html").as_uri(),
        ],
        capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    answer = re.search(r'<pre id="answer">(.*?)</pre>', done.stdout, re.DOTALL)
    assert answer is not None, f"status {done.returncode}: {done.stderr[-2000:]}"
    assert answer[1], done.stderr[-2000:]
    found = json.loads(answer[1])
    if "missing" in found:
        pytest.skip(f"{browser} has no {found['missing']}")
    assert "values" in found, found
    return {name: np.array(values, float).reshape(PAIRS, 4)[:, :3] for name, values in found["values"].items()}


@pytest.mark.parametrize("signed", [False, True])
@pytest.mark.parametrize("name", MODELS)
def test_a_shader_has_the_values_of_the_library(name, signed, shown):
    wi, wo = pairs()
    expected = np.asarray(MODELS[name](jnp.asarray(wi, DTYPE), jnp.asarray(wo, DTYPE)), float)
    expected = np.broadcast_to(expected if signed else np.maximum(expected, 0), (PAIRS, 3))
    found = shown[f"{name}, signed" if signed else name]
    scale = np.abs(expected).max()
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-5 * scale)
    assert np.all(found[48:56] == 0)
    assert scale > 0.05


def test_text_says_what_it_is_and_goes_to_a_file(tmp_path):
    model = MODELS["compact"]
    write_glsl(tmp_path / "brdf.glsl", model, name="satin")
    text = (tmp_path / "brdf.glsl").read_text(encoding="ascii")
    assert text == glsl_source(model, name="satin")
    assert text.startswith("// LogLinearBRDF over 30 functions (HalfVectorBasis), 3 channels")
    assert "vec3 satin(vec3 wi, vec3 wo) {" in text
    assert text.count("series += vec3(") == 30


@pytest.mark.parametrize("name", ["2d", "gl_brdf", "a__b", "a b", "größe", "", *RESERVED])
def test_names_that_are_none_are_refused(name):
    with pytest.raises(ValueError, match="cannot be called"):
        glsl_source(MODELS["hsh"], name=name)


def test_models_that_do_not_fit_a_shader_are_refused():
    with pytest.raises(ValueError, match="got Lambert"):
        glsl_source(hshjax.Lambert(0.5))
    with pytest.raises(ValueError, match="1 or 3 channels, got 2"):
        glsl_source(linear(bases.IsotropicBasis(bases.HSH(1)), channels=2))
    basis = bases.IsotropicBasis(bases.HSH(0))
    with pytest.raises(ValueError, match="finite in single precision, got 1" if X64 else "not all finite"):
        glsl_source(hshjax.LinearBRDF(basis, np.full((1, 1), 1e41 if X64 else np.inf)))
    low = np.array([-1.0, -np.inf, -1.0], DTYPE)
    with pytest.raises(ValueError, match="finite in all channels or in none"):
        glsl_source(hshjax.LogLinearBRDF(bases.HalfVectorBasis(1), [np.zeros(1, DTYPE)] * 3, low=low))
