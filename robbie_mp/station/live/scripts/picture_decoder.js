// Decodes the stream of the camera to drive by; the other end is live/h264.py. A picture is shown only if it is the very next
// one of the stream: if one is missing, or the decoder fails or stops, the station sends JPEG, and later begins a new stream.

const CONFIG = { codec: "avc1.42E028", optimizeForLatency: true }; // H.264, constrained baseline, up to 1920 x 1080
const LIMIT_MS = 500; // a decoder that takes longer has stopped
const RETRY_MS = 10_000;
const MAX_FAILURES = 5; // without STEADY pictures between them
const STEADY = 300;

export class PictureDecoder {
  // changed(): called when the page wants another stream, or none.
  constructor(changed) {
    Object.assign(this, { changed, camera: undefined, decoder: null, number: 0, failures: 0, why: "", untold: undefined });
  }

  // Returns a decoder; null: this browser cannot decode the streams.
  static async make(changed) {
    const { supported } = await VideoDecoder.isConfigSupported(CONFIG);
    return supported ? new PictureDecoder(changed) : null;
  }

  // Returns what to tell the station: the stream that is wanted, and why the one before has failed.
  wants(camera, is_new) {
    if (camera !== this.camera || is_new) this.begin(camera);
    const failed = this.untold;
    this.untold = undefined;
    return { decodes: this.decoder ? [this.camera, this.number] : undefined, failed };
  }

  // What a picture without a stream should say.
  note(camera) {
    return camera === this.camera && this.why ? `JPEG: ${this.why}` : "";
  }

  begin(camera) {
    this.end();
    this.camera = camera;
    if (camera === undefined || this.failures >= MAX_FAILURES) return;
    const decoder = new VideoDecoder({
      output: (frame) => (decoder === this.decoder && frame.timestamp === this.awaited ? this.answer(frame) : frame.close()),
      error: ({ message }) => decoder === this.decoder && this.fail(`the video decoder failed (${message})`),
    });
    decoder.configure(CONFIG);
    Object.assign(this, { decoder, number: this.number + 1, next: 0, why: "" });
  }

  end() {
    clearTimeout(this.retry);
    if (this.decoder && this.decoder.state !== "closed") this.decoder.close();
    this.decoder = null;
    this.answer(null);
  }

  // Returns a promise of the picture; null: it must not be shown.
  decode({ decoder, number, is_key }, data) {
    if (!this.decoder || decoder !== this.number) return null;
    if (number !== this.next) return this.fail("a picture of the video is missing");
    this.next += 1;
    if (number === STEADY) this.failures = 0;
    this.awaited = number;
    return new Promise((done) => {
      this.done = done;
      this.timer = setTimeout(() => this.fail("the video decoder does not answer"), LIMIT_MS);
      try {
        this.decoder.decode(new EncodedVideoChunk({ type: is_key ? "key" : "delta", timestamp: number, data }));
      } catch (error) {
        this.fail(`the video decoder refused a picture (${error.message})`);
      }
    });
  }

  answer(frame) {
    clearTimeout(this.timer);
    this.done?.(frame);
    this.done = null;
  }

  fail(why) {
    this.failures += 1;
    this.why = this.untold = why;
    this.end();
    if (this.failures < MAX_FAILURES) this.retry = setTimeout(() => this.again(), RETRY_MS);
    this.changed();
    return null;
  }

  again() {
    this.begin(this.camera);
    this.changed();
  }
}
