const KEY = "cardan-token";

/** The token of the address's fragment, which is taken out of the address; else the one kept for
 * this tab. A fragment is neither sent to the server nor told to other pages. */
export function takeToken(): string {
  const given = new URLSearchParams(location.hash.slice(1)).get("t");
  if (given) {
    sessionStorage.setItem(KEY, given);
    history.replaceState(null, "", location.pathname + location.search);
  }
  return given ?? sessionStorage.getItem(KEY) ?? "";
}
