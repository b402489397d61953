// An error with the decoder's message. `kind` is format, version, limit or parameter; network if something cannot be fetched; internal if
// the decoder itself failed.
export class SsplatError extends Error {
  constructor(kind, words) {
    super(words)
    this.name = "SsplatError"
    this.kind = kind
  }
}
