// SPDX-License-Identifier: Apache-2.0
// Shows what WebGL drew without waiting for it. Where the processor draws, a
// browser that puts a WebGL canvas on the page waits on the page's thread until
// it is drawn, and the image beside it waits, too. So the pixels are fetched
// when they are ready and put into a canvas of our own.
export class Readback {
  readonly canvas = document.createElement("canvas");
  private readonly buffer: WebGLBuffer | null;
  private pixels = new Uint8Array(0);
  private image: ImageData | null = null;

  constructor(private readonly gl: WebGL2RenderingContext) {
    this.buffer = gl.createBuffer();
  }

  // Call when a frame was given to WebGL, before the fence behind it.
  fetch(): void {
    const { gl } = this;
    const { drawingBufferWidth: width, drawingBufferHeight: height } = gl;
    gl.bindBuffer(gl.PIXEL_PACK_BUFFER, this.buffer);
    if (this.image?.width !== width || this.image.height !== height) {
      this.image = new ImageData(width, height);
      this.pixels = new Uint8Array(4 * width * height);
      gl.bufferData(gl.PIXEL_PACK_BUFFER, this.pixels.byteLength, gl.STREAM_READ);
    }
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, 0);
    gl.bindBuffer(gl.PIXEL_PACK_BUFFER, null);
  }

  // Call when that fence has been passed.
  show(): void {
    const { gl, image } = this;
    if (!image) return;
    gl.bindBuffer(gl.PIXEL_PACK_BUFFER, this.buffer);
    gl.getBufferSubData(gl.PIXEL_PACK_BUFFER, 0, this.pixels);
    gl.bindBuffer(gl.PIXEL_PACK_BUFFER, null);
    const { width, height } = image;
    // WebGL's first row is the lowest one.
    for (let y = 0; y < height; ++y) {
      const row = 4 * width * (height - 1 - y);
      image.data.set(this.pixels.subarray(row, row + 4 * width), 4 * width * y);
    }
    if (this.canvas.width !== width || this.canvas.height !== height) {
      this.canvas.width = width;
      this.canvas.height = height;
    }
    this.canvas.getContext("2d", { alpha: false })!.putImageData(image, 0, 0);
  }

  dispose(): void {
    this.gl.deleteBuffer(this.buffer);
  }
}
