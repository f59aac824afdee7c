// The search takes a word that begins with a hyphen for one to leave out. Here it is an option, such as --time-format.
"use strict";
(() => {
  const QUERY = 2; // Material's SearchMessageType
  const post = Worker.prototype.postMessage;
  Worker.prototype.postMessage = function (message, ...rest) {
    const asked = message?.type === QUERY && typeof message.data === "string";
    const words = asked ? { ...message, data: message.data.replace(/(^|\s|")-+(?=\w)/g, "$1") } : message;
    return post.call(this, words, ...rest);
  };
})();
