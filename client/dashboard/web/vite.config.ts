// SPDX-License-Identifier: Apache-2.0
import { defineConfig } from "vitest/config";

// `npm run dev` serves the page alone and passes everything else on to a proxy
// that runs on this machine.
const proxy = process.env.GROUNDLOCK_DASHBOARD ?? "http://127.0.0.1:8080";

export default defineConfig({
  base: "./",
  build: {
    target: "es2022",
    outDir: process.env.GROUNDLOCK_WEB_OUT ?? "dist",
    emptyOutDir: true,
    assetsInlineLimit: 0, // the page's security policy allows no data: scripts
    chunkSizeWarningLimit: 900,
    rollupOptions: {
      output: { manualChunks: { three: ["three"] } },
    },
  },
  server: {
    proxy: {
      "/ws": { target: proxy, ws: true },
      "/api": { target: proxy },
    },
  },
  test: { include: ["test/**/*.test.ts"] },
});
