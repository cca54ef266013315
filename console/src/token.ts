const KEY = "cardan-token";

/** Begin anew with this token. */
export function giveToken(token: string): void {
  sessionStorage.setItem(KEY, token);
  location.reload();
}

// An address with another token, opened in the page's own tab, does not load the page by itself.
addEventListener("hashchange", () => {
  if (tokenInAddress()) location.reload();
});

/** The token of the address's fragment, which is taken out of the address; else the one kept for
 * this tab. A fragment is neither sent to the server nor told to other pages. */
export function takeToken(): string {
  const given = tokenInAddress();
  if (given) {
    sessionStorage.setItem(KEY, given);
    history.replaceState(null, "", location.pathname + location.search);
  }
  return given ?? sessionStorage.getItem(KEY) ?? "";
}

function tokenInAddress(): string | null {
  return new URLSearchParams(location.hash.slice(1)).get("t");
}
