"use strict";(()=>{try{let t=localStorage.getItem("graphfix.theme");(t==="light"||t==="dark")&&(document.documentElement.dataset.theme=t)}catch{}})();
