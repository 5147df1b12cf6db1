// The page: connection → store → views; commands and sliders → connection.

import { Commands } from "./commands.js";
import { Connection } from "./connection.js";
import { Controls } from "./controls.js";
import { ErrorChart } from "./error_chart.js";
import { FrameView } from "./frame_view.js";
import { SkyView } from "./sky_view.js";
import { Store } from "./state.js";
import { Status } from "./status.js";
import { Theme } from "./theme.js";

const url = new URL("ws", document.baseURI);
url.protocol = location.protocol === "https:" ? "wss:" : "ws:";
url.search = location.search;

const connection = new Connection(url.href);
const store = new Store(connection);
const theme = new Theme();
const frame = new FrameView(store);
const chart = new ErrorChart(store);
new SkyView(store);
new Status(store);
new Controls(store, connection);
new Commands(store, connection, { frame, chart, theme });
connection.start();
