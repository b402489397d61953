// Ends a browser that was started as the leader of a process group, with its children. `ended` resolves when it has ended.
export async function end(browser, ended) {
  try {
    process.kill(-browser.pid, "SIGKILL")
  } catch {
    browser.kill("SIGKILL")
  }
  await ended
}
